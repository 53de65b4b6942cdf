/** Names for people: of a Task, of its performer, and of a process. */
import type { ProcessView, TaskView } from "~/live/messages";
import { exactTime } from "~/design/times";
import { shortName } from "~/live/urn";

/** The performer of a Task: the first that it involves but for Materials and Assets, "" without one. */
export function performerOf(task: Pick<TaskView, "involves">): string {
  const first = task.involves.find((one) => !/^urn:ngsi-ld:(Material|Asset):/.test(one));
  return first === undefined ? "" : shortName(first);
}

/** The name of a Task: that of its activity, or the id of the activity if it has no name. */
export function nameOf(task: Pick<TaskView, "name" | "element">): string {
  return task.name === "" ? task.element : task.name;
}

/** Identifies a process of its definition: the business key, else the time of its start. */
export function markOf(process: Pick<ProcessView, "key" | "startedAt">, language: string): string {
  return process.key ?? exactTime(process.startedAt, language);
}

/** A Task within its process, short enough for a URL: "pick-2" is the second visit to `pick`. */
export function taskMark(task: Pick<TaskView, "element" | "visit">): string {
  return `${task.element}-${task.visit}`;
}
