/** The operator's acts: pause, go on, complete by hand. Starting and retrying are everybody's (`~/api/acts`). */
import { callService } from "~/api/http";

export function pauseGlove(glove: string): Promise<unknown> {
  return callService("gesture-controller", `gloves/${encodeURIComponent(glove)}/pause`, { method: "POST" });
}

export function resumeGlove(glove: string): Promise<unknown> {
  return callService("gesture-controller", `gloves/${encodeURIComponent(glove)}/resume`, { method: "POST" });
}

/** Complete `task`, the one that was in sight when the button was pressed, and no other that may have come since. */
export function completeByHand(glove: string, task: string | undefined, by: string): Promise<unknown> {
  return callService("gesture-controller", `gloves/${encodeURIComponent(glove)}/complete`, { method: "POST", json: { by, task } });
}

/**
 * Wish that whoever performs `task` pauses or goes on. The wish carries no time: the clock of a screen is
 * not to be trusted, and the newest wish counts.
 */
export function wish(task: string, status: "paused" | "inProgress"): Promise<unknown> {
  return callService("context-broker", `ngsi-ld/v1/entities/${encodeURIComponent(task)}/attrs`, {
    method: "POST",
    json: { requestedStatus: { type: "Property", value: status } },
  });
}
