/** The Tasks of a process as a table. */
import { useMemo } from "react";
import { useTranslation } from "react-i18next";
import { DataTable, type Column } from "~/design/table/DataTable";
import { useSorting } from "~/design/table/useSorting";
import { duration, exactTime } from "~/design/times";
import { localizedText } from "~/i18n/server";
import { useNow } from "~/live/clock";
import type { TaskView } from "~/api/generated/task-orchestrator";
import type { Status } from "~/live/messages";
import { nameOf, performerOf, taskMark } from "../names";
import { TaskState } from "../process/TaskState";
import { CLOCK } from "./axis";
import { courseOf } from "./course";

const BY_STATUS: readonly Status[] = ["pending", "assigned", "inProgress", "paused", "completed", "failed"];

export interface TaskTableProps {
  tasks: readonly TaskView[];
  picked: string;
  onPick: (task: string) => void;
}

export function TaskTable({ tasks, picked, onPick }: TaskTableProps) {
  const { t } = useTranslation("processes");
  const [sorting, setSorting] = useSorting("when", "taskSort");
  return (
    <DataTable
      label={t("tasks.table")}
      rows={tasks}
      columns={useColumns()}
      keyOf={taskMark}
      nameOf={nameOf}
      rowHeight={37}
      sorting={sorting}
      onSort={setSorting}
      openKey={picked}
      onOpen={(task) => onPick(taskMark(task) === picked ? "" : taskMark(task))}
    />
  );
}

function useColumns(): readonly Column<TaskView>[] {
  const { t, i18n } = useTranslation(["processes", "common"]);
  return useMemo(
    () => [
      { id: "what", name: t("tasks.what"), width: "minmax(150px, 2fr)", sortBy: nameOf, cell: (task) => <strong>{nameOf(task)}</strong> },
      { id: "who", name: t("tasks.who"), width: "minmax(80px, 1fr)", sortBy: performerOf, cell: performerOf },
      { id: "status", name: t("tasks.status"), width: "minmax(130px, 1.2fr)", sortBy: (task) => BY_STATUS.indexOf(task.status), cell: (task) => <TaskState task={task} /> },
      {
        id: "when", name: t("tasks.when"), width: "76px", isDescendingFirst: true, sortBy: (task) => Date.parse(task.createdAt),
        cell: (task) => (
          <time dateTime={task.createdAt} title={exactTime(task.createdAt, i18n.language)}>
            {new Date(task.createdAt).toLocaleTimeString(i18n.language, CLOCK)}
          </time>
        ),
      },
      {
        id: "waited", name: t("tasks.waited"), width: "84px", isNumber: true, isDescendingFirst: true, sortBy: (task) => courseOf(task, Date.now()).waitedMs,
        cell: (task) => <CourseTime task={task} of="waitedMs" />,
      },
      {
        id: "worked", name: t("tasks.worked"), width: "96px", isNumber: true, isDescendingFirst: true, sortBy: (task) => courseOf(task, Date.now()).workedMs,
        cell: (task) => <CourseTime task={task} of="workedMs" />,
      },
      { id: "why", name: t("tasks.why"), width: "minmax(120px, 2fr)", cell: (task) => localizedText(task, "reason") },
    ],
    [t, i18n.language],
  );
}

/** A duration of a Task; it counts whole seconds while the Task is open. */
function CourseTime({ task, of }: { task: TaskView; of: "waitedMs" | "workedMs" }) {
  const { i18n } = useTranslation();
  const now = useNow();
  const course = courseOf(task, now);
  return duration(course.ended ? course[of] : Math.floor(course[of] / 1000) * 1000, i18n.language);
}
