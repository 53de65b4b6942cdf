/** Sessions of persons: begin one, follow it, read its report and the weeks, and delete what is kept of a person. */
import { Pause, Play, Square, Trash2 } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import type { SessionView, WeekView } from "~/api/generated/whole-body-control";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { Checkbox } from "~/design/Checkbox";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Field } from "~/design/Field";
import { number, percent } from "~/design/numbers";
import { Select } from "~/design/Select";
import { StatusBadge } from "~/design/StatusBadge";
import { clockTime, span } from "~/design/times";
import { Slider } from "~/control/Slider";
import { requestService } from "~/api/http";
import { shortName } from "~/live/urn";
import { UnknownName } from "~/route/UnknownName";
import { useQueryChange, useQueryParameter } from "~/route/queryParameter";
import { mayDo } from "~/session/session";
import { SERVICE, type LiveDocument, type SessionState } from "./humanoid";
import { ProgressChart } from "./ProgressChart";
import { useAct } from "./useAct";
import "~/design/Figures.css";

const LIST_EVERY_MS = 5000;

export function SessionCard({ document, behaviours }: { document: LiveDocument; behaviours: readonly string[] }) {
  const { t } = useTranslation("humanoid");
  const { session } = document;
  const runs = session !== null && session.state !== "ended";
  return (
    <Card title={t("session.title")} aside={session === null ? undefined : <StatusBadge tone={session.state === "running" ? "accent" : session.state === "paused" ? "attention" : "neutral"}>{t(`session.state.${session.state}`)}</StatusBadge>}>
      {session !== null && <Running session={session} />}
      {!runs && <Begin behaviours={behaviours} />}
    </Card>
  );
}

function Running({ session }: { session: SessionState }) {
  const { t, i18n } = useTranslation("humanoid");
  const { failure, act } = useAct();
  const path = `sessions/${session.id}`;
  const isOver = session.state === "ended";
  const figures: [string, string][] = [
    ["exercised", span(session.exercisedS, i18n.language)],
    ...(session.application === "juggling"
      ? ([
          ["score", number(session.score, i18n.language)],
          ["caught", `${session.caught} / ${session.throws}`],
          ["level", percent(session.level, i18n.language)],
        ] as [string, string][])
      : ([["distance", `${number(session.distanceM, i18n.language)} m`]] as [string, string][])),
  ];
  return (
    <div className="humanoid-session">
      <p>
        <strong>{t(`application.${session.application}`)}</strong>
        {session.pauseReason !== "" && ` · ${session.pauseReason.split(", ").map((reason) => t(`session.pause.${reason}`, { defaultValue: reason })).join(", ")}`}
        {session.endedBy !== null && ` · ${t(`session.ended.${session.endedBy}`, { defaultValue: session.endedBy })}`}
      </p>
      <progress aria-label={t("session.progress")} max={1} value={session.progress} />
      <dl className="humanoid-session__figures">
        {figures.map(([name, text]) => (
          <div key={name}>
            <dt className="small quiet">{t(`session.figure.${name}`)}</dt>
            <dd>{text}</dd>
          </div>
        ))}
      </dl>
      {!isOver && (
        <div className="humanoid__acts">
          {session.state === "running" ? (
            <Button size="large" icon={<Pause aria-hidden size={22} />} onPress={() => void act(`${path}/pause`)}>{t("session.act.pause")}</Button>
          ) : (
            <Button kind="main" size="large" icon={<Play aria-hidden size={22} />} onPress={() => void act(`${path}/resume`)}>{t("session.act.resume")}</Button>
          )}
          <Button size="large" icon={<Square aria-hidden size={22} />} onPress={() => void act(`${path}/end`)}>{t("session.act.end")}</Button>
        </div>
      )}
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
    </div>
  );
}

function Begin({ behaviours }: { behaviours: readonly string[] }) {
  const { t, i18n } = useTranslation("humanoid");
  const offered = [...(behaviours.includes("juggling") ? ["juggling"] : []), ...(behaviours.includes("assistedWalking") ? ["walking"] : [])];
  const [application, setApplication] = useState(offered[0] ?? "juggling");
  const [person, setPerson] = useState("");
  const [throws, setThrows] = useState(10);
  const [minutes, setMinutes] = useState(5);
  const [level, setLevel] = useState(0.1);
  const [isAdaptive, setAdaptive] = useState(true);
  const [needsGrip, setNeedsGrip] = useState(false);
  const { failure, isBusy, act } = useAct();
  const isJuggling = application === "juggling";
  const begin = () =>
    act("sessions", {
      application,
      ...(person.trim() === "" ? {} : { person: person.trim() }),
      goal: isJuggling ? { throws } : { seconds: 60 * minutes },
      ...(isJuggling ? { startLevel: level, isAdaptive, needsGrip } : {}),
    });
  return (
    <div className="humanoid-session">
      <div className="humanoid__fields">
        <Select label={t("session.application")} value={application} options={offered.map((one) => ({ value: one, name: t(`application.${one}`) }))} onChange={setApplication} />
        <Field label={t("session.person")} value={person} onChange={setPerson} />
      </div>
      {isJuggling ? (
        <>
          <Slider label={t("session.throws")} value={throws} min={1} max={100} step={1} text={number(throws, i18n.language)} onChange={setThrows} />
          <Slider label={t("session.level")} value={level} min={0} max={1} step={0.05} text={percent(level, i18n.language)} onChange={setLevel} />
          <Checkbox isSelected={isAdaptive} onChange={setAdaptive}>{t("session.adaptive")}</Checkbox>
          <Checkbox isSelected={needsGrip} onChange={setNeedsGrip}>{t("session.grip")}</Checkbox>
        </>
      ) : (
        <Slider label={t("session.minutes")} value={minutes} min={1} max={60} step={1} text={t("session.minutesText", { count: minutes })} onChange={setMinutes} />
      )}
      <p className="small quiet">{t("session.needsPatient")}</p>
      <Button kind="main" size="large" icon={<Play aria-hidden size={22} />} isDisabled={isBusy} onPress={() => void begin()}>
        {t("session.begin", { application: t(`application.${application}`) })}
      </Button>
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
    </div>
  );
}

/** The sessions that are kept, of all persons whom the reader may see, or of one with its weeks. */
export function SessionsCard() {
  const { t, i18n } = useTranslation("humanoid");
  const [person, setPerson] = useQueryParameter("person");
  const [shown, setShown] = useQueryParameter("session");
  const change = useQueryChange();
  const [isDeleting, setDeleting] = useState(false);
  const { value: all, failure, reload } = useServiceQuery<SessionView[]>(SERVICE, "sessions", { intervalMs: LIST_EVERY_MS });
  const people = [...new Set((all ?? []).flatMap((one) => (one.person === null ? [] : [shortName(one.person)])))].sort();
  const listed = (all ?? []).filter((one) => person === "" || (one.person !== null && shortName(one.person) === person));
  const isKnown = all?.some(({ id }) => id === shown) === true;
  const isListed = people.includes(person);
  return (
    <Card title={t("sessions.title")}>
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      {all !== null && all.length === 0 ? (
        <p className="quiet">{t("sessions.none")}</p>
      ) : (
        <>
          <div className="humanoid__acts">
            <Select label={t("sessions.of")} value={person} options={[{ value: "", name: t("sessions.all") }, ...people.map((name) => ({ value: name, name }))]} onChange={setPerson} />
            {person !== "" && mayDo("managePeople") && (
              <Button icon={<Trash2 aria-hidden size={18} />} onPress={() => setDeleting(true)}>{t("sessions.delete")}</Button>
            )}
          </div>
          {isListed && <Weeks person={person} />}
          <div className="humanoid__scroll">
            <table className="figures">
              <thead>
                <tr>
                  {(["began", "person", "application", "figures", "ended"] as const).map((name) => <th key={name} scope="col">{t(`sessions.column.${name}`)}</th>)}
                </tr>
              </thead>
              <tbody>
                {listed.slice(0, 50).map((one) => (
                  <tr key={one.id}>
                    <th scope="row">
                      <button type="button" className="humanoid__link" aria-expanded={shown === one.id} onClick={() => setShown(shown === one.id ? "" : one.id)}>
                        {clockTime(one.startedAt, i18n.language)}
                      </button>
                    </th>
                    <td>{one.person === null ? "–" : shortName(one.person)}</td>
                    <td>{t(`application.${one.application}`)}</td>
                    <td>{one.application === "juggling" ? t("sessions.caught", { caught: one.caught, throws: one.throws, score: one.score }) : `${number(one.distanceM, i18n.language)} m`}</td>
                    <td>{one.endedBy === null ? t("session.state.running") : t(`session.ended.${one.endedBy}`, { defaultValue: one.endedBy })}</td>
                  </tr>
                ))}
              </tbody>
            </table>
          </div>
          {isKnown && <Report key={shown} session={shown} />}
        </>
      )}
      {all !== null && person !== "" && !isListed && <UnknownName thing="value" name={person} parameter="person" />}
      {all !== null && shown !== "" && !isKnown && <UnknownName thing="session" name={shown} parameter="session" />}
      <ConfirmDialog
        isOpen={isDeleting}
        onClose={() => setDeleting(false)}
        title={t("sessions.deleteAsk", { person })}
        act={t("sessions.delete")}
        kind="stop"
        onAct={async () => {
          await requestService(SERVICE, `persons/${encodeURIComponent(person)}`, { method: "DELETE" });
          change({ person: "", session: "" }); // the open session may be one of theirs
          reload();
        }}
      >
        <p>{t("sessions.deleteMeans")}</p>
      </ConfirmDialog>
    </Card>
  );
}

function Weeks({ person }: { person: string }) {
  const { value: weeks, failure } = useServiceQuery<WeekView[]>(SERVICE, `persons/${encodeURIComponent(person)}/progress`, { intervalMs: LIST_EVERY_MS });
  if (failure !== null) return <ErrorMessage>{failure}</ErrorMessage>;
  return weeks === null || weeks.length === 0 ? null : <ProgressChart weeks={weeks} />;
}

interface ThrowReport {
  atS: number;
  level: number;
  result: "caught" | "missed" | "lost";
  side: "left" | "right" | null;
  closestM: number | null;
}

interface ReportView extends SessionView {
  outcomes?: ThrowReport[];
  shareCaught?: number | null;
  longestRun?: number;
  walkedS?: number;
  highestForceN?: number | null;
}

function Report({ session }: { session: string }) {
  const { t, i18n } = useTranslation("humanoid");
  const { value: report, failure } = useServiceQuery<ReportView>(SERVICE, `sessions/${session}/report`, { intervalMs: LIST_EVERY_MS });
  if (report === null) return failure === null ? null : <ErrorMessage>{failure}</ErrorMessage>;
  const figures: [string, string][] = [["exercised", span(report.exercisedS, i18n.language)]];
  if (report.shareCaught != null) figures.push(["share", percent(report.shareCaught, i18n.language)]);
  if (report.longestRun !== undefined) figures.push(["run", number(report.longestRun, i18n.language)]);
  if (report.walkedS !== undefined) figures.push(["distance", `${number(report.distanceM, i18n.language)} m`]);
  if (report.highestForceN != null) figures.push(["force", `${number(report.highestForceN, i18n.language, { maximumFractionDigits: 0 })} N`]);
  return (
    <section className="humanoid-report" aria-label={t("report.title")}>
      <h3>{t("report.title")}</h3>
      <dl className="humanoid-session__figures">
        {figures.map(([name, text]) => (
          <div key={name}>
            <dt className="small quiet">{t(`session.figure.${name}`)}</dt>
            <dd>{text}</dd>
          </div>
        ))}
      </dl>
      {report.outcomes !== undefined && report.outcomes.length > 0 && (
        <ol className="humanoid-report__throws">
          {report.outcomes.map((one, index) => (
            <li key={index}>
              <StatusBadge tone={one.result === "caught" ? "ok" : "neutral"}>{t(`ball.${one.result}`)}</StatusBadge>
              <span className="small quiet">
                {span(one.atS, i18n.language)} · {t("session.figure.level")} {percent(one.level, i18n.language)}
                {one.side !== null && ` · ${t(`side.${one.side}`)}`}
                {one.closestM !== null && ` · ${number(100 * one.closestM, i18n.language, { maximumFractionDigits: 0 })} cm`}
              </span>
            </li>
          ))}
        </ol>
      )}
    </section>
  );
}
