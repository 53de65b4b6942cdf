/** Data of the dashboard: waiting Tasks by resource, and processes that need attention. */
import type { ProcessView, TaskView } from "~/api/generated/task-orchestrator";
import { processState } from "~/live/processState";
import { shortName } from "~/live/urn";

export interface Waiting {
  process: ProcessView;
  task: TaskView;
  /** The short name of the first resource; "" without one. */
  who: string;
  /** The time of the last change of the Task's state. */
  since: string;
}

/** The open Tasks, the longest waiting first, so that new Tasks do not move the others. */
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

/** The number of open Tasks by resource, the highest first. */
export function byPerformer(waiting: readonly Waiting[]): { who: string; count: number; since: string }[] {
  const found = new Map<string, { who: string; count: number; since: string }>();
  for (const { who, since } of waiting) {
    const group = found.get(who);
    if (group === undefined) found.set(who, { who, count: 1, since });
    else group.count += 1;
  }
  return [...found.values()].sort((a, b) => b.count - a.count || (a.who < b.who ? -1 : 1));
}

/** The processes that failed since a time, the newest first. */
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

/** The start of the day of `now` (in ms), in the local time zone. */
export function startOfDay(now: number): string {
  const day = new Date(now);
  day.setHours(0, 0, 0, 0);
  return day.toISOString();
}
