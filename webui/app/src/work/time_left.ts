/** How long a robot still takes, as far as anybody knows. */
import type { ElementCount, RobotView, TaskView } from "~/live/messages";

/**
 * Return whole seconds, at least one: what the robot itself says, else what this step has taken so far in
 * this process; null if it was never done, or takes longer than it ever did.
 */
export function secondsLeft(
  robot: Pick<RobotView, "remainingS"> | null,
  task: Pick<TaskView, "createdAt">,
  count: Pick<ElementCount, "medianMs"> | undefined,
  nowMs: number,
): number | null {
  if (robot?.remainingS != null) return Math.max(1, Math.ceil(robot.remainingS));
  const medianMs = count?.medianMs ?? null;
  if (medianMs === null) return null;
  const leftMs = medianMs - Math.max(0, nowMs - Date.parse(task.createdAt));
  return leftMs > 0 ? Math.ceil(leftMs / 1000) : null;
}
