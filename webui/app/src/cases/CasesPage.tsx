/** Cases: machines that adapt to the body of a person, live, with the figures of the paper beside ours. */
import { HandHelping, OctagonX, Play, RotateCcw, TestTubeDiagonal } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import type { HistoryView, MachineView, TrialView } from "~/api/generated/assistive-devices";
import { errorText, requestService } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { EmptyState } from "~/design/EmptyState";
import { ErrorMessage } from "~/design/ErrorMessage";
import { number, percent } from "~/design/numbers";
import { Select } from "~/design/Select";
import { StatusBadge } from "~/design/StatusBadge";
import { reasonOf } from "~/health/health";
import { VitalSigns } from "~/health/VitalSigns";
import { localizedText } from "~/i18n/server";
import { UnknownName } from "~/route/UnknownName";
import { useQueryParameter } from "~/route/queryParameter";
import "~/health/HealthPage.css";
import { CaseChart } from "./CaseChart";
import { limitTone, pathOf, SERVICE, stateOf, valueText } from "./cases";
import { trainerOf } from "./trainer";
import { TrainerCard } from "./TrainerCard";
import "./CasesPage.css";

const EVERY_MS = 500;

export default function CasesPage() {
  const { t } = useTranslation(["cases", "health", "devices", "common"]);
  const { value: machines, failure, reload } = useServiceQuery<MachineView[]>(SERVICE, "machines", { intervalMs: EVERY_MS });
  const [asked, setAsked] = useQueryParameter("case");
  const machine = machines?.find(({ case: name }) => name === asked) ?? (asked === "" ? machines?.[0] : undefined) ?? null;
  return (
    <div className="cases">
      <header className="health__head">
        <h1>{t("common:pages.cases")}</h1>
        {machines !== null && machines.length > (machine === null ? 0 : 1) && (
          <Select label={t("case")} value={machine?.case ?? ""} options={machines.map(({ case: name }) => ({ value: name, name: t(`name.${name}`, { defaultValue: name }) }))} onChange={setAsked} />
        )}
      </header>
      <p className="health__notice small quiet">{t("notSafe")}</p>
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      {machine !== null && <Machine key={machine.case} machine={machine} onChange={reload} />}
      {machine === null && machines !== null && (asked === "" ? <EmptyState icon={<HandHelping aria-hidden size={32} />} title={t("none")} /> : <UnknownName thing="case" name={asked} parameter="case" />)}
    </div>
  );
}

function Machine({ machine, onChange }: { machine: MachineView; onChange: () => void }) {
  const { t, i18n } = useTranslation(["cases", "health"]);
  const history = useServiceQuery<HistoryView>(SERVICE, `${pathOf(machine.case)}/history`, { intervalMs: 2 * EVERY_MS }).value;
  const [failure, setFailure] = useState<string | null>(null);
  const act = (name: string, json?: unknown) => {
    setFailure(null);
    void requestService(SERVICE, `${pathOf(machine.case)}/${name}`, { method: "POST", ...(json === undefined ? {} : { json }) })
      .then(onChange)
      .catch((error: unknown) => setFailure(errorText(error)));
  };
  const { limit, trial } = machine;
  const trainer = trainerOf(machine);
  const heartRate = machine.vitals.find(({ name, status }) => name === "heartRate" && status === "valid")?.value;
  return (
    <div className="health__body">
      <Card title={t(`name.${machine.case}`, { defaultValue: machine.case })} className="cases__machine" aside={<StatusBadge tone={machine.isMoving ? "accent" : "neutral"}>{t(`state.${machine.state}`, { defaultValue: machine.state })}</StatusBadge>}>
        <p>{t(`means.${machine.case}`, { defaultValue: "" })}</p>
        <p className="small quiet">{machine.robot}{machine.problem !== "" && ` · ${machine.problem}`}</p>
        <dl className="cases__values">
          {machine.values.map(({ name, value, unit }) => (
            <div key={name}>
              <dt className="small quiet">{t(`value.${name}`, { defaultValue: name })}</dt>
              <dd>{valueText(value, unit, i18n.language)}</dd>
            </div>
          ))}
        </dl>
        <div className="cases__acts">
          <Button kind="stop" size="large" icon={<OctagonX aria-hidden size={22} />} onPress={() => act("stop")}>{t("stop")}</Button>
          {trainer === null && <Button icon={<Play aria-hidden size={18} />} onPress={() => act("start")}>{t("start")}</Button>}
          <Button icon={<TestTubeDiagonal aria-hidden size={18} />} isDisabled={trial?.isRunning === true} onPress={() => act("trial", {})}>{t("trial.begin")}</Button>
        </div>
        {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      </Card>
      <Card title={t("health:limit.title")} className="health__limit" aside={<StatusBadge tone={limitTone(limit)}>{t(limit.needsReset || limit.fraction === 0 ? "health:limit.stopped" : limit.fraction < 1 ? "health:limit.slowed" : "health:limit.full")}</StatusBadge>}>
        <p className="health__fraction" data-stopped={limit.fraction === 0 || undefined}>
          <output>{percent(limit.fraction, i18n.language)}</output> <span className="quiet small">{t("health:limit.ofSpeed")}</span>
        </p>
        <Reason reason={limit.reason} />
        {limit.needsReset && <Button kind="main" icon={<RotateCcw aria-hidden size={18} />} onPress={() => act("reset")}>{t("health:limit.reset")}</Button>}
      </Card>
      {trainer !== null && (
        <div className="health__wide">
          <TrainerCard trainer={trainer} isMoving={machine.isMoving || machine.state === "following"} heartRateBpm={typeof heartRate === "number" ? heartRate : null} onStart={(options) => act("start", { options })} />
        </div>
      )}
      <VitalSigns state={stateOf(machine)} silentS={0} isOld={machine.problem !== ""} />
      {history !== null && history.atS.length > 1 && (
        <div className="health__wide">
          <Card title={t("course")}><CaseChart history={history} /></Card>
        </div>
      )}
      {trial !== null && <div className="health__wide"><Trial trial={trial} /></div>}
    </div>
  );
}

function Reason({ reason: text }: { reason: string }) {
  const { t } = useTranslation("health");
  // The machine names its own stop around that of human state.
  const reason = reasonOf({ reason: reasonOf({ reason: text }).text });
  return <p>{reason.key === "other" ? reason.text : t(`limit.reason.${reason.key}`, { seconds: reason.seconds })}</p>;
}

function Trial({ trial }: { trial: TrialView }) {
  const { t, i18n } = useTranslation("cases");
  const outcome = trial.isRunning ? "runs" : trial.passed ? "passed" : "failed";
  return (
    <Card title={t("trial.title")} aside={<StatusBadge tone={trial.isRunning ? "accent" : trial.passed ? "ok" : "stop"}>{t(`trial.${outcome}`)}</StatusBadge>}>
      {trial.failure !== "" && <ErrorMessage>{localizedText(trial, "failure")}</ErrorMessage>}
      <ol className="cases__messages small" aria-label={t("trial.messages")}>
        {trial.messages.map((message) => (
          <li key={`${message.atS} ${message.text}`}>
            <span className="quiet">{t("seconds", { seconds: number(message.atS, i18n.language, { maximumFractionDigits: 0 }) })}</span> {localizedText(message, "text")}
          </li>
        ))}
      </ol>
      {trial.figures.length > 0 && (
        <div className="cases__scroll">
          <table className="cases__figures">
            <thead>
              <tr><th>{t("figure")}</th><th>{t("paper")}</th><th>{t("here")}</th><th>{t("decided")}</th></tr>
            </thead>
            <tbody>
              {trial.figures.map((each) => (
                <tr key={each.name}>
                  <td>{localizedText(each, "name")}</td><td>{localizedText(each, "paper")}</td><td>{localizedText(each, "ours")}</td>
                  <td>{each.passed !== null && <StatusBadge tone={each.passed ? "ok" : "stop"}>{t(each.passed ? "trial.ok" : "trial.notOk")}</StatusBadge>}</td>
                </tr>
              ))}
            </tbody>
          </table>
        </div>
      )}
    </Card>
  );
}
