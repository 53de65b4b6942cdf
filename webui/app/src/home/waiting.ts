/** Open Tasks and processes as Home lists them: what has waited longest first, so that new ones do not move the others. */
import type { ProcessView, TaskView } from "~/api/generated/task-orchestrator";
import type { TasklistView } from "~/live/messages";
import { processState } from "~/live/processState";
import { shortName } from "~/live/urn";
import { isFree, isInView, isLater, isMine, type Identity } from "~/tasks/list";

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

/** The running processes, the longest running first. */
export function runningProcesses(processes: readonly ProcessView[]): ProcessView[] {
  return processes
    .filter((process) => process.endedAt === null)
    .sort((a, b) => (a.startedAt === b.startedAt ? (a.id < b.id ? -1 : 1) : a.startedAt < b.startedAt ? -1 : 1));
}

/** The Tasks that wait for a person: those of the person and of the person's groups, then those that anybody may claim. */
export function tasksFor(tasks: readonly TasklistView[], who: Identity, nowMs: number): { own: TasklistView[]; free: TasklistView[] } {
  const now = tasks.filter((task) => !isLater(task, nowMs, who)).sort((a, b) => compareText(a.since ?? "", b.since ?? "") || compareText(a.id, b.id));
  const own = now.filter((task) => isMine(task, who) || (isFree(task) && isInView(task, "groups", who)));
  return { own, free: now.filter((task) => !own.includes(task) && isInView(task, "free", who) && (task.groups.length === 0 || who.groups.length === 0)) };
}

function compareText(a: string, b: string): number {
  return a < b ? -1 : a > b ? 1 : 0;
}
