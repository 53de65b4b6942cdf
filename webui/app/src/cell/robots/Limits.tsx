/** What limits the speed of a robot: the rule that holds, the distance of people, and the reset of a stop. */
import { useState } from "react";
import { useTranslation } from "react-i18next";
import type { RobotLimitsView, SafetyStatusView } from "~/api/generated/trajectory-tool";
import { requestService } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Button } from "~/design/Button";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { Field } from "~/design/Field";
import { percent } from "~/design/numbers";
import { localizedText } from "~/i18n/server";
import { metres } from "~/robot/units";

const EVERY_MS = 1000;

export function Limits({ robot }: { robot: string }) {
  const { t, i18n } = useTranslation("system");
  const path = `robots/${encodeURIComponent(robot)}/limits`;
  const { value: limits, reload } = useServiceQuery<RobotLimitsView>("trajectory-tool", path, { intervalMs: EVERY_MS });
  if (limits === null) return null;
  const { distance, required, lost } = limits.separation;
  // At rest there is no motion to slow down, yet the tool may not be faster.
  const isSpeed = limits.maxSpeed !== null && limits.pace > 0;
  const { safetyStatus } = limits;
  const isStoppedByController = safetyStatus !== null && (safetyStatus.emergencyStop || safetyStatus.protectiveStop || safetyStatus.safeguardStop);
  const whole = (force: number) => force.toLocaleString(i18n.language, { maximumFractionDigits: 0 });
  return (
    <section className="limits">
      <h3>{t("limit.title")}</h3>
      {!(limits.rule === null && isStoppedByController) && (
        <p data-stopped={limits.pace === 0 || undefined}>
          {limits.rule === null
            ? t("limit.none")
            : t(isSpeed ? "limit.holdsSpeed" : "limit.holds", {
                percent: percent(limits.pace, i18n.language),
                speed: whole((limits.maxSpeed ?? 0) * 1000),
                rule: t(`limit.rule.${limits.rule}`, { defaultValue: limits.rule }),
                reason: localizedText(limits, "reason") ?? "",
              })}
        </p>
      )}
      {distance !== null && required !== null && (
        <p>{t("limit.distance", { distance: metres(distance, i18n.language), required: metres(required, i18n.language) })}</p>
      )}
      {limits.separation.fields.map((field) => (
        <p key={field.source} data-stopped={field.protective || undefined}>
          {t(field.protective ? "limit.protectiveField" : field.warning ? "limit.warningField" : "limit.fieldsFree", { scanner: field.source })}
        </p>
      ))}
      {limits.contact.force !== null && (
        <p>{t(limits.contact.limit === null ? "limit.force" : "limit.forceWithLimit", { force: whole(limits.contact.force), limit: whole(limits.contact.limit ?? 0) })}</p>
      )}
      {safetyStatus !== null && <Controller status={safetyStatus} />}
      {limits.needsReset && <ByPerson path={`${path}/reset`} label={t("limit.reset")} means={t("limit.resetMeans")} onDone={reload} />}
      {lost.length > 0 && (
        <ByPerson path={`${path}/confirm-clear`} label={t("limit.clear")} means={t("limit.clearMeans", { people: lost.join(", ") })} onDone={reload} />
      )}
      <p className="quiet small">{t("limit.notice")}</p>
    </section>
  );
}

/** The safety functions of the real robot, as its controller reports them. */
function Controller({ status }: { status: SafetyStatusView }) {
  const { t, i18n } = useTranslation("system");
  const { speed } = status;
  const detail = localizedText(status, "detail") ?? "";
  const mode = status.mode
    .split(", ")
    .map((name) => t(`limit.state.${name}`, { defaultValue: name }))
    .join(", ");
  return (
    <>
      <p>
        {status.mode === "" || speed === null ? t("limit.controllerUnknown", { detail }) : t("limit.controller", { mode, percent: percent(speed, i18n.language) })}
      </p>
      {status.emergencyStop && <p data-stopped>{t("limit.emergencyStop")}</p>}
      {status.protectiveStop && <p data-stopped>{t("limit.protectiveStop", { detail })}</p>}
      {status.safeguardStop && <p data-stopped>{t("limit.safeguardStop", { detail })}</p>}
    </>
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
      <Button permission="moveRobots" onPress={() => setIsAsking(true)}>{label}</Button>
      <ConfirmDialog isOpen={isAsking} onClose={() => setIsAsking(false)} title={label} act={label} kind="stop" isDisabled={name.trim() === ""} onAct={act}>
        <p>{means}</p>
        <Field label={t("limit.name")} value={name} onChange={setName} isRequired />
      </ConfirmDialog>
    </>
  );
}
