/** Names for people: of a Task and of its performer. A process has its `name` from the orchestrator. */
import type { TaskView } from "~/api/generated/task-orchestrator";
import { shortName } from "~/live/urn";

/** The performer of a Task: the first that it involves but for Materials and Assets, else who claimed it, else "". */
export function performerOf(task: Pick<TaskView, "involves"> & Partial<Pick<TaskView, "outputParameters">>): string {
  const first = task.involves.find((one) => !/^urn:ngsi-ld:(Material|Asset):/.test(one));
  if (first !== undefined) return shortName(first);
  const operator = task.outputParameters?.["operator"];
  return typeof operator === "string" ? operator : "";
}

const MAX_TITLE = 32;

/** A title that fits a button. */
export function shortTitle(title: string): string {
  return title.length > MAX_TITLE ? `${title.slice(0, MAX_TITLE - 1).trimEnd()}…` : title;
}

/** The name of a Task: that of its activity, or the id of the activity if it has no name. */
export function nameOf(task: Pick<TaskView, "name" | "element">): string {
  return task.name === "" ? task.element : task.name;
}

/** A Task within its process, short enough for a URL: "pick-2" is the second visit to `pick`. */
export function taskMark(task: Pick<TaskView, "element" | "visit">): string {
  return `${task.element}-${task.visit}`;
}
