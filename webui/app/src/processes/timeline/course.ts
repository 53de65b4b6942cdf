/**
 * The course of a Task: created, accepted, in progress, ended; times in ms of one clock. Performers use their own
 * clocks, so times that would run backwards are corrected.
 */
import type { TaskView } from "~/api/generated/task-orchestrator";
import type { Status } from "~/live/messages";

export interface Stretch {
  status: Status;
  fromMs: number;
  toMs: number;
}

export interface Course {
  fromMs: number;
  /** The end, or the present time while the Task is open. */
  toMs: number;
  ended: boolean;
  stretches: Stretch[];
  /** The time until its performer began. */
  waitedMs: number;
  /** The time in progress, without pauses. */
  workedMs: number;
}

type Timed = Pick<TaskView, "createdAt" | "endedAt" | "history" | "status">;

/** The course of a Task as it is at `nowMs`. */
export function courseOf(task: Timed, nowMs: number): Course {
  const fromMs = Date.parse(task.createdAt);
  const ended = task.endedAt !== null;
  const toMs = Math.max(fromMs, task.endedAt === null ? nowMs : Date.parse(task.endedAt));
  const moves = [{ status: "pending" as Status, at: fromMs }];
  for (const move of task.history) {
    const before = moves.at(-1)?.at ?? fromMs;
    const at = Math.min(toMs, Math.max(before, Date.parse(move.at)));
    // Its end is the end of its last stretch, no stretch of its own.
    if (move.status === "completed" || move.status === "failed") continue;
    if (move.status === "pending" && moves.length === 1) continue;
    moves.push({ status: move.status, at });
  }
  const stretches = moves
    .map((move, nth) => ({ status: move.status, fromMs: move.at, toMs: moves[nth + 1]?.at ?? toMs }))
    .filter((stretch, _nth, all) => stretch.toMs > stretch.fromMs || all.length === 1);
  const begun = moves.find((move) => move.status === "inProgress");
  return {
    fromMs,
    toMs,
    ended,
    stretches,
    waitedMs: (begun?.at ?? toMs) - fromMs,
    workedMs: stretches
      .filter((stretch) => stretch.status === "inProgress")
      .reduce((sum, stretch) => sum + stretch.toMs - stretch.fromMs, 0),
  };
}
