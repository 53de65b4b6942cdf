/** The tasklist: which Tasks a person sees, in which order, and what they are called. */
import type { ProcessView, TasklistView } from "~/live/messages";
import { isSame, shortName } from "~/live/urn";

export interface ListedTask {
  task: TasklistView;
  name: string;
  process: ProcessView | null;
}

/** All Tasks with their names and processes; the earliest deadline first, then by name. */
export function listedTasks(tasks: readonly TasklistView[], processes: readonly ProcessView[]): ListedTask[] {
  return tasks
    .map((task) => {
      const process = processes.find((one) => one.tasks.some(({ id }) => isSame(id, task.id))) ?? null;
      const known = process?.tasks.find(({ id }) => isSame(id, task.id));
      const drawn = known === undefined || known.name === "" ? null : known.name;
      return { task, process, name: drawn ?? task.description ?? task.kind };
    })
    .sort((a, b) => (a.task.deadline ?? "9").localeCompare(b.task.deadline ?? "9") || a.name.localeCompare(b.name) || a.task.id.localeCompare(b.task.id));
}

/** Whether a Task is of a person: claimed under the name, or assigned to the person and claimed by nobody. */
export function isMine({ claimedBy, person }: TasklistView, name: string): boolean {
  if (name === "") return false;
  return claimedBy === name || (claimedBy === null && person !== null && shortName(person).toLowerCase() === name.toLowerCase());
}
