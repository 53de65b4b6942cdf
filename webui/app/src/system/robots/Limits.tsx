/** What limits the speed of a robot: the rule that holds, the distance of people, and the reset of a stop. */
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { requestService } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Button } from "~/design/Button";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { Field } from "~/design/Field";
import { percent } from "~/design/numbers";
import { metres } from "~/robot/units";

const EVERY_MS = 1000;

interface SafetyStatus {
  emergencyStop: boolean;
  protectiveStop: boolean;
  mode: string;
  detail: string;
}

interface RobotLimits {
  pace: number;
  rule: string | null;
  reason: string | null;
  needsReset: boolean;
  separation: { distance: number | null; required: number | null; lost: string[] };
  safetyStatus: SafetyStatus | null;
}

export function Limits({ robot }: { robot: string }) {
  const { t, i18n } = useTranslation("system");
  const path = `robots/${encodeURIComponent(robot)}/limits`;
  const { value: limits, reload } = useServiceQuery<RobotLimits>("trajectory-tool", path, { intervalMs: EVERY_MS });
  if (limits === null) return null;
  const { distance, required, lost } = limits.separation;
  return (
    <section className="limits">
      <h3>{t("limit.title")}</h3>
      <p data-stopped={limits.pace === 0 || undefined}>
        {limits.rule === null
          ? t("limit.none")
          : t("limit.holds", {
              percent: percent(limits.pace, i18n.language),
              rule: t(`limit.rule.${limits.rule}`, { defaultValue: limits.rule }),
              reason: limits.reason ?? "",
            })}
      </p>
      {distance !== null && required !== null && (
        <p>{t("limit.distance", { distance: metres(distance, i18n.language), required: metres(required, i18n.language) })}</p>
      )}
      {limits.safetyStatus?.emergencyStop === true && <p>{t("limit.emergencyStop")}</p>}
      {limits.safetyStatus?.protectiveStop === true && <p>{t("limit.protectiveStop", { detail: limits.safetyStatus.detail })}</p>}
      {limits.needsReset && <ByPerson path={`${path}/reset`} label={t("limit.reset")} means={t("limit.resetMeans")} onDone={reload} />}
      {lost.length > 0 && (
        <ByPerson path={`${path}/confirm-clear`} label={t("limit.clear")} means={t("limit.clearMeans", { people: lost.join(", ") })} onDone={reload} />
      )}
      <p className="quiet small">{t("limit.notice")}</p>
    </section>
  );
}

/** A button whose dialog asks for the name of the person. */
function ByPerson({ path, label, means, onDone }: { path: string; label: string; means: string; onDone: () => void }) {
  const { t } = useTranslation("system");
  const [isAsking, setIsAsking] = useState(false);
  const [name, setName] = useState("");
  const act = async () => {
    await requestService("trajectory-tool", path, { method: "POST", json: { name } });
    onDone();
  };
  return (
    <>
      <Button onPress={() => setIsAsking(true)}>{label}</Button>
      <ConfirmDialog isOpen={isAsking} onClose={() => setIsAsking(false)} title={label} act={label} kind="stop" isDisabled={name.trim() === ""} onAct={act}>
        <p>{means}</p>
        <Field label={t("limit.name")} value={name} onChange={setName} isRequired />
      </ConfirmDialog>
    </>
  );
}
