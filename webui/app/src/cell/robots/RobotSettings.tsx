/** The settings of a robot: its mode, the validated speed of its end effector, and its measured stop. Each change asks who makes it. */
import { useState } from "react";
import { useTranslation } from "react-i18next";
import type { ModeChange, RobotLimitsView, SafeSpeedChange, StopChange } from "~/api/generated/trajectory-tool";
import { requestService } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Field } from "~/design/Field";
import { number, typedNumber } from "~/design/numbers";
import { userName } from "~/shell/userName";
import "../objects/ObjectHistory.css";

const SERVICE = "trajectory-tool";

export default function RobotSettings({ robot }: { robot: string }) {
  const { t } = useTranslation("cell");
  const path = `robots/${encodeURIComponent(robot)}/limits`;
  const { value: limits, failure, reload } = useServiceQuery<RobotLimitsView>(SERVICE, path);
  if (limits === null) return failure === null ? null : <ErrorMessage>{failure}</ErrorMessage>;
  return (
    <div className="history">
      <Mode path={`${path}/mode`} limits={limits} onDone={reload} />
      <SafeSpeed path={`${path}/safe-speed`} limits={limits} onDone={reload} />
      <Stop path={`${path}/stop`} limits={limits} onDone={reload} />
      <p className="quiet small">{t("settings.notice")}</p>
    </div>
  );
}

interface PartProps {
  path: string;
  limits: RobotLimitsView;
  onDone: () => void;
}

function Mode({ path, limits, onDone }: PartProps) {
  const { t } = useTranslation("cell");
  const other = limits.mode === "normal" ? "reduced" : "normal";
  return (
    <Card title={t("settings.mode")}>
      <p>{t(`limits.mode.${limits.mode}`)}</p>
      <Change act={t(`settings.to.${other}`)} means={t(`settings.means.${other}`)} isComplete onAct={(name) => put(path, { mode: other, name } satisfies ModeChange).then(onDone)} />
    </Card>
  );
}

function SafeSpeed({ path, limits, onDone }: PartProps) {
  const { t, i18n } = useTranslation("cell");
  const current = limits.safeSpeeds.find(({ endEffector }) => endEffector === limits.endEffector) ?? limits.safeSpeeds[0];
  const [endEffector, setEndEffector] = useState(current?.endEffector ?? limits.endEffector ?? "");
  const [speed, setSpeed] = useState("");
  const [date, setDate] = useState("");
  const speedMps = typedNumber(speed, i18n.language);
  return (
    <Card title={t("settings.safeSpeed")}>
      {limits.safeSpeeds.length === 0 && <p className="quiet">{t("settings.noSafeSpeed")}</p>}
      {limits.safeSpeeds.map((entry) => (
        <p key={entry.endEffector}>{t("settings.validated", { effector: entry.endEffector, speed: number(entry.speedMps, i18n.language), date: day(entry.validatedAt, i18n.language) })}</p>
      ))}
      <Change
        act={t("settings.enterSpeed")}
        means={t("settings.speedMeans")}
        isComplete={endEffector.trim() !== "" && speedMps !== null && date !== ""}
        onAct={(name) => put(path, { endEffector: endEffector.trim(), speedMps: speedMps ?? 0, validatedAt: instant(date), name } satisfies SafeSpeedChange).then(onDone)}
      >
        <Field label={t("settings.endEffector")} value={endEffector} onChange={setEndEffector} isRequired />
        <Field label={t("settings.speed")} value={speed} onChange={setSpeed} inputMode="decimal" isRequired />
        <Field label={t("settings.validatedAt")} type="date" value={date} onChange={setDate} isRequired />
      </Change>
    </Card>
  );
}

function Stop({ path, limits, onDone }: PartProps) {
  const { t, i18n } = useTranslation("cell");
  const { stopping } = limits;
  const [delay, setDelay] = useState("");
  const [deceleration, setDeceleration] = useState("");
  const [date, setDate] = useState("");
  const [delayS, decelerationMps2] = [typedNumber(delay, i18n.language), typedNumber(deceleration, i18n.language)];
  const values = { delay: number(stopping.delay, i18n.language, { maximumFractionDigits: 3 }), deceleration: number(stopping.deceleration, i18n.language) };
  return (
    <Card title={t("settings.stop")}>
      <p>{stopping.measuredAt === null ? t("settings.assumed", values) : t("settings.measured", { ...values, date: day(stopping.measuredAt, i18n.language) })}</p>
      <Change
        act={t("settings.enterStop")}
        means={t("settings.stopMeans")}
        isComplete={delayS !== null && decelerationMps2 !== null && date !== ""}
        onAct={(name) => put(path, { delayS: delayS ?? 0, decelerationMps2: decelerationMps2 ?? 0, measuredAt: instant(date), name } satisfies StopChange).then(onDone)}
      >
        <Field label={t("settings.delay")} value={delay} onChange={setDelay} inputMode="decimal" isRequired />
        <Field label={t("settings.deceleration")} value={deceleration} onChange={setDeceleration} inputMode="decimal" isRequired />
        <Field label={t("settings.measuredAt")} type="date" value={date} onChange={setDate} isRequired />
      </Change>
    </Card>
  );
}

interface ChangeProps {
  act: string;
  means: string;
  isComplete: boolean;
  onAct: (name: string) => Promise<unknown>;
  children?: React.ReactNode;
}

/** A button whose dialog says what the change means and asks for the values and the name of the person. */
function Change({ act, means, isComplete, onAct, children }: ChangeProps) {
  const { t } = useTranslation("cell");
  const [isAsking, setIsAsking] = useState(false);
  const [name, setName] = useState(userName);
  return (
    <>
      <Button permission="configure" onPress={() => setIsAsking(true)}>{act}</Button>
      <ConfirmDialog isOpen={isAsking} onClose={() => setIsAsking(false)} title={act} act={act} kind="stop" isDisabled={!isComplete || name.trim() === ""} onAct={() => onAct(name.trim()).then(() => undefined)}>
        <p>{means}</p>
        {children}
        <Field label={t("settings.name")} value={name} onChange={setName} isRequired />
      </ConfirmDialog>
    </>
  );
}

function put(path: string, json: unknown): Promise<unknown> {
  return requestService(SERVICE, path, { method: "PUT", json });
}

function day(at: string, language: string): string {
  return new Date(at).toLocaleDateString(language, { dateStyle: "medium" });
}

/** The begin of a day, in the time zone of the reader. */
function instant(date: string): string {
  return new Date(`${date}T00:00:00`).toISOString();
}
