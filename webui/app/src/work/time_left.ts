/** The remaining time of a robot's Task. */
import type { ElementCounts, TaskView } from "~/api/generated/task-orchestrator";
import type { RobotView } from "~/live/messages";

/**
* Return whole seconds, at least one: the robot's own estimate, else an estimate from earlier durations of the
* step in this process; null without them, or if it takes longer than ever before.
 */
export function secondsLeft(
  robot: Pick<RobotView, "remainingS"> | null,
  task: Pick<TaskView, "createdAt">,
  count: Pick<ElementCounts, "medianMs"> | undefined,
  nowMs: number,
): number | null {
  if (robot?.remainingS != null) return Math.max(1, Math.ceil(robot.remainingS));
  const medianMs = count?.medianMs ?? null;
  if (medianMs === null) return null;
  const leftMs = medianMs - Math.max(0, nowMs - Date.parse(task.createdAt));
  return leftMs > 0 ? Math.ceil(leftMs / 1000) : null;
}
