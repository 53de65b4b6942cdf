/** Presets: positions of the joints that the person drives to while the button is held. */
import { Trash2 } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { Field } from "~/design/Field";
import type { Driver } from "./driver";
import { HoldButton } from "./HoldButton";
import { useUserSetting } from "./useUserSetting";

interface Presets {
  presets: { name: string; position: number[] }[];
}

const NONE: Presets = { presets: [] };
const MAX_PRESETS = 30;

function isPresets(value: unknown): value is Presets {
  const list = (value as Partial<Presets> | null)?.presets;
  return (
    Array.isArray(list) &&
    list.every(({ name, position }: { name: unknown; position: unknown }) => typeof name === "string" && Array.isArray(position) && position.every(Number.isFinite))
  );
}

export interface PresetsPanelProps {
  robot: string;
  driver: Driver;
  isOn: boolean;
  home: readonly number[] | null;
  position: readonly number[];
}

export function PresetsPanel({ robot, driver, isOn, home, position }: PresetsPanelProps) {
  const { t } = useTranslation("control");
  const [{ presets }, save] = useUserSetting(`control.presets.${robot.replace(/[^A-Za-z0-9.-]/g, "-").slice(0, 40)}`, NONE, isPresets);
  const [name, setName] = useState("");
  const rows = [...(home === null ? [] : [{ name: t("presets.home"), position: [...home], isFixed: true }]), ...presets.map((one) => ({ ...one, isFixed: false }))];
  const add = () => {
    save({ presets: [...presets.filter((one) => one.name !== name.trim()), { name: name.trim(), position: [...position] }].slice(-MAX_PRESETS) });
    setName("");
  };
  return (
    <div className="presets">
      <ul>
        {rows.map((preset) => (
          <li key={`${preset.name} ${preset.isFixed}`}>
            <HoldButton isDisabled={!isOn} onHold={(isHeld) => driver.goTo(isHeld ? preset.position : null)}>
              {t("presets.goTo", { name: preset.name })}
            </HoldButton>
            {!preset.isFixed && (
              <Button
                kind="quiet"
                label={t("presets.delete", { name: preset.name })}
                icon={<Trash2 aria-hidden size={18} />}
                onPress={() => save({ presets: presets.filter((one) => one.name !== preset.name) })}
              />
            )}
          </li>
        ))}
      </ul>
      <div className="presets__new">
        <Field label={t("presets.name")} value={name} onChange={setName} maxLength={40} />
        <Button isDisabled={name.trim() === "" || position.length === 0} onPress={add}>
          {t("presets.save")}
        </Button>
      </div>
    </div>
  );
}
