/** A Task in full: who, when, how long, what was asked, what came of it, and why it failed. */
import { X } from "lucide-react";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { duration } from "~/design/times";
import { localizedText } from "~/i18n/server";
import { useNow } from "~/live/clock";
import type { ProcessView, TaskView } from "~/api/generated/task-orchestrator";
import { isSame, shortName } from "~/live/urn";
import { RetryButton } from "../incidents/RetryButton";
import { nameOf } from "../names";
import { CLOCK } from "../timeline/axis";
import { courseOf } from "../timeline/course";
import { Json } from "./Values";
import { TaskState } from "./TaskState";
import "./TaskPanel.css";

export interface TaskPanelProps {
  process: ProcessView;
  task: TaskView;
  onClose: () => void;
}

export function TaskPanel({ process, task, onClose }: TaskPanelProps) {
  const { t, i18n } = useTranslation(["processes", "common"]);
  const now = useNow();
  const course = courseOf(task, now);
  const stopped = process.incidents.find((incident) => isSame(incident.task, task.id));
  const clock = (at: string) => new Date(at).toLocaleTimeString(i18n.language, CLOCK);
  const said = (ms: number) => duration(task.endedAt === null ? Math.floor(ms / 1000) * 1000 : ms, i18n.language);
  return (
    <aside className="task" aria-label={t("task.label", { task: nameOf(task) })}>
      <header className="task__head">
        <h2>{nameOf(task)}</h2>
        <TaskState task={task} />
        <Button kind="quiet" label={t("task.close")} icon={<X aria-hidden size={18} />} onPress={onClose} />
      </header>
      <Reason task={task} />
      {stopped !== undefined && <RetryButton process={process} token={stopped.token} step={nameOf(task)} kind="plain" />}
      {task.description !== null && <p>{task.description}</p>}
      <dl className="task__facts">
        <dt>{t("task.who")}</dt>
        <dd>{task.involves.length === 0 ? t("task.nobody") : task.involves.map(shortName).join(", ")}</dd>
        <dt>{t("task.waited")}</dt>
        <dd>{said(course.waitedMs)}</dd>
        <dt>{t("task.worked")}</dt>
        <dd>{said(course.workedMs)}</dd>
        {task.deadline !== null && task.endedAt === null && (
          <>
            <dt>{t("task.deadline")}</dt>
            <dd>{clock(task.deadline)}</dd>
          </>
        )}
        {task.dueDate !== null && task.endedAt === null && (
          <>
            <dt>{t("task.dueDate")}</dt>
            <dd>{clock(task.dueDate)}</dd>
          </>
        )}
        {task.priority !== null && (
          <>
            <dt>{t("task.priority")}</dt>
            <dd>{task.priority}</dd>
          </>
        )}
        <dt>{t("task.visit")}</dt>
        <dd>{task.visit}</dd>
      </dl>
      <h3>{t("task.history")}</h3>
      <ol className="task__history">
        {task.history.map((move, nth) => (
          <li key={nth}>
            <time dateTime={move.at}>{clock(move.at)}</time> {t(`common:status.${move.status}`)}
          </li>
        ))}
      </ol>
      <h3>{t("task.asked")}</h3>
      <Json value={task.workParameters} label={t("task.asked")} />
      {task.outputParameters !== null && (
        <>
          <h3>{t("task.answered")}</h3>
          <Json value={task.outputParameters} label={t("task.answered")} />
        </>
      )}
    </aside>
  );
}

/** The reason of the failure, or the answer of the person with their note. */
function Reason({ task }: { task: TaskView }) {
  const { t } = useTranslation("processes");
  const { outcome, operator, note } = task.outputParameters ?? {};
  if (outcome !== "notGood" && outcome !== "problem") return task.reason === null ? null : <p className="task__reason">{localizedText(task, "reason")}</p>;
  const what = t(`outcome.${outcome}`);
  return (
    <p className="task__reason">
      {typeof operator === "string" ? t("outcome.by", { what, who: operator }) : what}
      {typeof note === "string" && note !== "" && ` ${t("outcome.note", { note })}`}
    </p>
  );
}
