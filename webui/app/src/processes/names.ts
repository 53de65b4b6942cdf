/** Names for people: of a Task, of its performer, and of a process. */
import type { ProcessView, TaskView } from "~/api/generated/task-orchestrator";
import { exactTime } from "~/design/times";
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

const MADE_BY_PAGE = /^[lm][0-9a-z]{7}-[0-9a-z]{7,8}$|^\S+ by \S+ after \S+$/;

/** The business key of a process; null without one, and for the random keys that earlier versions of this page have made. */
export function businessKey({ key }: Pick<ProcessView, "key">): string | null {
  return key === null || MADE_BY_PAGE.test(key) ? null : key;
}

/** The title of a process with its business key: "Bin picking · order 7"; without a key, with its id. */
export function fullName(process: Pick<ProcessView, "id" | "key" | "title">): string {
  return `${process.title} · ${businessKey(process) ?? process.id.slice(process.id.lastIndexOf("-") + 1)}`;
}

/** Identifies a process of its definition: the business key, else the time of its start. */
export function markOf(process: Pick<ProcessView, "key" | "startedAt">, language: string): string {
  return businessKey(process) ?? exactTime(process.startedAt, language);
}

/** A Task within its process, short enough for a URL: "pick-2" is the second visit to `pick`. */
export function taskMark(task: Pick<TaskView, "element" | "visit">): string {
  return `${task.element}-${task.visit}`;
}
