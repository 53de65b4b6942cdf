/** Names as people use them: of a Task, of whoever performs it, and of a process among its like. */
import type { ProcessView, TaskView } from "~/live/messages";
import { exactTime } from "~/design/times";
import { shortName } from "~/live/urn";

/** Whoever acts for the first resource that a Task involves performs it; nobody is "". */
export function performerOf(task: Pick<TaskView, "involves">): string {
  const [first] = task.involves;
  return first === undefined ? "" : shortName(first);
}

/** What a Task is called: its activity's name, or the activity's id where the file has no name. */
export function nameOf(task: Pick<TaskView, "name" | "element">): string {
  return task.name === "" ? task.element : task.name;
}

/** What tells a process from the others of its definition: its business key, else when it was started. */
export function markOf(process: Pick<ProcessView, "key" | "startedAt">, language: string): string {
  return process.key ?? exactTime(process.startedAt, language);
}

/** A Task within its process, short enough for a URL: "pick-2" is the second visit to `pick`. */
export function taskMark(task: Pick<TaskView, "element" | "visit">): string {
  return `${task.element}-${task.visit}`;
}
