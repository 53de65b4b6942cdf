/** The Tasks of a process that fit the filter, as a timeline or as a table. */
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { EmptyState } from "~/design/EmptyState";
import type { ProcessView } from "~/api/generated/task-orchestrator";
import { useChosen } from "./chosen";
import { TaskTable } from "./TaskTable";
import { Timeline } from "./Timeline";
import "./TasksView.css";

export interface TasksViewProps {
  process: ProcessView;
  view: "timeline" | "table";
  picked: string;
  onPick: (task: string) => void;
}

export function TasksView({ process, view, picked, onPick }: TasksViewProps) {
  const { t } = useTranslation("processes");
  const { tasks, setText, setStatuses, setPerformer } = useChosen(process);
  const showAll = () => {
    setText("");
    setStatuses([]);
    setPerformer("");
  };
  return (
    <div className="tasks">
      {process.tasks.length === 0 ? (
        <EmptyState title={t("tasks.none")} />
      ) : tasks.length === 0 ? (
        <EmptyState title={t("tasks.noneFits")} act={<Button onPress={showAll}>{t("tasks.showAll")}</Button>} />
      ) : view === "timeline" ? (
        <Timeline process={process} tasks={tasks} picked={picked} onPick={onPick} />
      ) : (
        <TaskTable tasks={tasks} picked={picked} onPick={onPick} />
      )}
    </div>
  );
}
