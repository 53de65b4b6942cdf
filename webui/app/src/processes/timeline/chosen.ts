/** The filter of the Tasks, stored in the URL, and the matching Tasks. */
import type { ProcessView, TaskView } from "~/api/generated/task-orchestrator";
import type { Status } from "~/live/messages";
import { useQueryParameter } from "~/route/queryParameter";
import { filtered, statusesOf, type Filter } from "./filter";

export interface Chosen {
  filter: Filter;
  tasks: TaskView[];
  setText: (text: string) => void;
  setStatuses: (statuses: readonly Status[]) => void;
  setPerformer: (performer: string) => void;
}

export function useChosen(process: Pick<ProcessView, "tasks">): Chosen {
  const [text, setText] = useQueryParameter("filter");
  const [wanted, setWanted] = useQueryParameter("status");
  const [performer, setPerformer] = useQueryParameter("who");
  const filter = { text, statuses: statusesOf(wanted), performer };
  return {
    filter,
    tasks: filtered(process.tasks, filter),
    setText,
    setStatuses: (statuses) => setWanted(statuses.join(",")),
    setPerformer,
  };
}
