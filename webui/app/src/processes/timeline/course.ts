/**
 * Course: how a Task went, in moments of one clock (ms). It is handed out, taken up, worked on, and ends.
 * Performers note the moments with clocks of their own, so what would run backwards is straightened.
 */
import type { Status, TaskView } from "~/live/messages";

export interface Stretch {
  status: Status;
  fromMs: number;
  toMs: number;
}

export interface Course {
  fromMs: number;
  /** Until when it went, or has gone by now. */
  toMs: number;
  ended: boolean;
  stretches: Stretch[];
  /** How long it lay before somebody began to work on it. */
  waitedMs: number;
  /** How long it was worked on, pauses not counted. */
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
