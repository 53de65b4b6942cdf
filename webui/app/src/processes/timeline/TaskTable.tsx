/** The Tasks as a table: the timeline for those who read or listen rather than look. */
import { memo } from "react";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { duration, exactTime } from "~/design/times";
import { localizedText } from "~/i18n/server";
import { useNow } from "~/live/clock";
import type { TaskView } from "~/live/messages";
import { nameOf, performerOf, taskMark } from "../names";
import { TaskState } from "../process/TaskState";
import { CLOCK } from "./axis";
import { courseOf } from "./course";

/** More rows than this make a page slow; the export has all. */
const MAX_ROWS = 500;

export interface TaskTableProps {
  tasks: readonly TaskView[];
  picked: string;
  onPick: (task: string) => void;
}

export function TaskTable({ tasks, picked, onPick }: TaskTableProps) {
  const { t } = useTranslation("processes");
  const now = useNow();
  const shown = tasks.slice(-MAX_ROWS);
  return (
    <div className="tasks__scroll" tabIndex={0} role="region" aria-label={t("tasks.table")}>
      {shown.length < tasks.length && <p className="quiet small">{t("timeline.onlyLast", { count: shown.length })}</p>}
      <table className="tasks__table">
        <thead>
          <tr>
            {(["what", "who", "status", "when", "waited", "worked", "why"] as const).map((column) => (
              <th key={column} scope="col">
                {t(`tasks.${column}`)}
              </th>
            ))}
          </tr>
        </thead>
        <tbody>
          {shown.map((task) => (
            <Row key={task.id} task={task} now={task.endedAt === null ? now : 0} picked={taskMark(task) === picked} onPick={onPick} />
          ))}
        </tbody>
      </table>
    </div>
  );
}

interface RowProps {
  task: TaskView;
  now: number;
  picked: boolean;
  onPick: (task: string) => void;
}

const Row = memo(
  function Row({ task, now, picked, onPick }: RowProps) {
    const { i18n } = useTranslation(["processes", "common"]);
    const course = courseOf(task, now);
    const said = (ms: number) => duration(course.ended ? ms : Math.floor(ms / 1000) * 1000, i18n.language);
    const at = new Date(task.createdAt);
    return (
      <tr className={picked ? "tasks__row tasks__row--picked" : "tasks__row"}>
        <th scope="row">
          <Button kind="quiet" aria-expanded={picked} onPress={() => onPick(picked ? "" : taskMark(task))}>
            {nameOf(task)}
          </Button>
        </th>
        <td>{performerOf(task)}</td>
        <td>
          <TaskState task={task} />
        </td>
        <td>
          <time dateTime={task.createdAt} title={exactTime(task.createdAt, i18n.language)}>
            {at.toLocaleTimeString(i18n.language, CLOCK)}
          </time>
        </td>
        <td className="tasks__number">{said(course.waitedMs)}</td>
        <td className="tasks__number">{said(course.workedMs)}</td>
        <td className="tasks__why">{localizedText(task, "reason")}</td>
      </tr>
    );
  },
  (before, after) =>
    before.picked === after.picked &&
    before.onPick === after.onPick &&
    before.now === after.now &&
    before.task.status === after.task.status &&
    before.task.reason === after.task.reason &&
    before.task.history.length === after.task.history.length,
);
