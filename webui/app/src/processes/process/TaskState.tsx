/** The state of a Task, with the answer of the person, and whether its performer is connected. */
import { useTranslation } from "react-i18next";
import { StatusBadge } from "~/design/StatusBadge";
import { statusTone } from "~/design/states";
import { useFamily } from "~/live/hooks";
import type { TaskView } from "~/api/generated/task-orchestrator";
import { isSame } from "~/live/urn";

export function TaskState({ task }: { task: TaskView }) {
  const { t } = useTranslation(["processes", "common"]);
  const absent = useAbsent(task);
  const outcome = task.outputParameters?.["outcome"];
  if (outcome === "notGood" || outcome === "problem") {
    return <StatusBadge tone={task.status === "failed" ? "stop" : "attention"}>{t(`outcome.${outcome}`)}</StatusBadge>;
  }
  if (absent !== null) return <StatusBadge tone="attention">{t("task.waitsFor", { who: absent })}</StatusBadge>;
  return <StatusBadge tone={statusTone[task.status]}>{t(`common:status.${task.status}`)}</StatusBadge>;
}

/** Return the glove that a Task waits for: the Task is accepted, but the glove is not connected. */
function useAbsent({ status, involves }: TaskView): string | null {
  const gloves = useFamily("glove");
  if (status !== "inProgress") return null;
  const asked = gloves.filter(({ glove, person }) => involves.some((one) => isSame(one, glove) || isSame(one, person)));
  return asked.length > 0 && asked.every(({ connected }) => !connected) ? (asked[0]?.glove ?? null) : null;
}
