/** What the dashboard shows of the cell: which Tasks wait for whom and since when, and which processes need a look. */
import type { ProcessView, TaskView } from "~/live/messages";
import { processState } from "~/live/processState";
import { shortName } from "~/live/urn";

export interface Waiting {
  process: ProcessView;
  task: TaskView;
  /** For whom, by the short name of the first resource; "" for nobody. */
  who: string;
  /** When the Task got the state it has. */
  since: string;
}

/** The open Tasks, the one that has waited longest first: an order that new Tasks do not change. */
export function waitingTasks(processes: readonly ProcessView[]): Waiting[] {
  const all = processes
    .filter((process) => process.endedAt === null)
    .flatMap((process) =>
      process.tasks
        .filter((task) => task.endedAt === null && !task.cancelled)
        .map((task) => {
          const [first] = task.involves;
          return { process, task, who: first === undefined ? "" : shortName(first), since: task.history.at(-1)?.at ?? task.createdAt };
        }),
    );
  return all.sort((a, b) => (a.since === b.since ? (a.task.id < b.task.id ? -1 : 1) : a.since < b.since ? -1 : 1));
}

/** How many open Tasks each has, the busiest first. */
export function byPerformer(waiting: readonly Waiting[]): { who: string; count: number; since: string }[] {
  const found = new Map<string, { who: string; count: number; since: string }>();
  for (const { who, since } of waiting) {
    const known = found.get(who);
    if (known === undefined) found.set(who, { who, count: 1, since });
    else known.count += 1;
  }
  return [...found.values()].sort((a, b) => b.count - a.count || (a.who < b.who ? -1 : 1));
}

/** The processes that failed since a moment, the newest first. */
export function failedSince(processes: readonly ProcessView[], since: string): ProcessView[] {
  return processes
    .filter((process) => process.status === "failed" && (process.endedAt ?? "") >= since)
    .sort((a, b) => ((a.endedAt ?? "") > (b.endedAt ?? "") ? -1 : 1));
}

/** The running processes with incidents, the oldest incident first. */
export function withIncidents(processes: readonly ProcessView[]): ProcessView[] {
  const since = (process: ProcessView) => process.incidents[0]?.since ?? "";
  return processes.filter((process) => processState(process) === "incident").sort((a, b) => (since(a) < since(b) ? -1 : 1));
}

/** The first moment of the day that `now` (in ms) is in, where the reader is. */
export function startOfDay(now: number): string {
  const day = new Date(now);
  day.setHours(0, 0, 0, 0);
  return day.toISOString();
}
