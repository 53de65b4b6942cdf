/** The filter of the Tasks of a process, stored in the URL. */
import { localizedText } from "~/i18n/server";
import type { TaskView } from "~/api/generated/task-orchestrator";
import type { Status } from "~/live/messages";
import { UnknownAddress } from "~/route/choice";
import { nameOf, performerOf, taskMark } from "../names";

export interface Filter {
  text: string;
  statuses: readonly Status[];
  performer: string;
}

export const statuses: readonly Status[] = ["pending", "assigned", "inProgress", "paused", "completed", "failed"];

/** Read the statuses from a URL; invalid ones are ignored. */
export function statusesOf(query: string): Status[] {
  const wanted = query === "" ? [] : query.split(",");
  const unknown = wanted.find((one) => !statuses.some((status) => status === one));
  if (unknown !== undefined) throw new UnknownAddress("status", unknown);
  return statuses.filter((status) => wanted.includes(status));
}

/** The Tasks that fit all that is asked; an empty filter lets all pass. Every word of the text must occur. */
export function filtered(tasks: readonly TaskView[], filter: Filter): TaskView[] {
  const words = filter.text.toLowerCase().split(/\s+/).filter((word) => word !== "");
  return tasks.filter(
    (task) =>
      (filter.statuses.length === 0 || filter.statuses.includes(task.status)) &&
      (filter.performer === "" || performerOf(task) === filter.performer) &&
      (words.length === 0 || fits(words, task)),
  );
}

/** All performers of some Tasks, by name. */
export function performersOf(tasks: readonly TaskView[]): string[] {
  return [...new Set(tasks.map(performerOf))].filter((name) => name !== "").sort();
}

function fits(words: readonly string[], task: TaskView): boolean {
  // Its full id names the process as well, and would fit "pick" for every Task of bin picking.
  const text = [nameOf(task), taskMark(task), performerOf(task), task.description, task.reason, localizedText(task, "reason")]
    .filter((part) => part !== null)
    .join("\n")
    .toLowerCase();
  return words.every((word) => text.includes(word));
}
