/** Shared control: how much the robot moves by itself, and what it takes the person to want. */
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { Checkbox } from "~/design/Checkbox";
import { percent } from "~/design/numbers";
import { metres } from "~/robot/units";
import type { ControlState } from "./connection";
import type { Driver } from "./driver";
import { Slider } from "./Slider";

const SHOWN_GOALS = 5;

export function SharedPanel({ driver, state }: { driver: Driver; state: ControlState | null }) {
  const { t, i18n } = useTranslation("control");
  const [mix, setMix] = useState(driver.mix);
  const [arbitration, setArbitration] = useState(driver.arbitration);
  const language = i18n.language;
  const goals = Object.entries(state?.goals ?? {}).sort(([a], [b]) => a.localeCompare(b));
  const best = goals.toSorted(([, a], [, b]) => b - a).slice(0, SHOWN_GOALS).map(([name]) => name);
  return (
    <div className="shared">
      <Slider
        label={t(arbitration ? "shared.most" : "shared.mix")}
        value={mix}
        min={0}
        max={1}
        step={0.05}
        text={mix.toLocaleString(language, { minimumFractionDigits: 2 })}
        ends={[t("shared.teleoperation"), t("shared.autonomous")]}
        onChange={(value) => {
          driver.set({ mix: value });
          setMix(value);
        }}
      />
      <Checkbox
        isSelected={arbitration}
        onChange={(isOn) => {
          driver.set({ arbitration: isOn });
          setArbitration(isOn);
        }}
      >
        {t("shared.arbitration")}
      </Checkbox>
      <dl className="control__values">
        <dt>{t("shared.now")}</dt>
        <dd>{(state?.mix ?? 0).toLocaleString(language, { minimumFractionDigits: 2, maximumFractionDigits: 2 })}</dd>
        <dt>{t("shared.goal")}</dt>
        <dd>{state?.goal ?? t("shared.noGoal")}</dd>
        <dt>{t("shared.confidence")}</dt>
        <dd>{percent(state?.confidence ?? 0, language)}</dd>
        <dt>{t("shared.distance")}</dt>
        <dd>{state?.goalDistanceM == null ? "–" : `${metres(state.goalDistanceM, language)} m`}</dd>
      </dl>
      {best.length > 0 && (
        <ul className="shared__goals">
          {goals.filter(([name]) => best.includes(name)).map(([name, share]) => (
            <li key={name} data-best={name === state?.goal || undefined}>
              <span>{name}</span>
              <meter min={0} max={1} value={share} aria-label={name} />
              <span>{percent(share, language)}</span>
            </li>
          ))}
        </ul>
      )}
    </div>
  );
}
