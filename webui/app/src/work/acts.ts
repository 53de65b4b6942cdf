/** The operator's acts: pause, go on, complete by hand. Starting and retrying are everybody's (`~/api/acts`). */
import { callService } from "~/api/http";
import type { Outcome } from "~/live/messages";

export function pauseGlove(glove: string): Promise<unknown> {
  return callService("gesture-controller", `gloves/${encodeURIComponent(glove)}/pause`, { method: "POST" });
}

export function resumeGlove(glove: string): Promise<unknown> {
  return callService("gesture-controller", `gloves/${encodeURIComponent(glove)}/resume`, { method: "POST" });
}

/**
 * Answer `task`, the one that was in sight when the button was pressed, and no other that may have come since.
 * With another outcome than `ok` it ends failed, unless its definition handles outcomes.
 */
export function answerByHand(glove: string, task: string | undefined, by: string, outcome: Outcome = "ok", note = ""): Promise<unknown> {
  const said = outcome === "ok" ? {} : { outcome, ...(note === "" ? {} : { note }) };
  return callService("gesture-controller", `gloves/${encodeURIComponent(glove)}/complete`, { method: "POST", json: { by, task, ...said } });
}

/** Leave testing mode: gestures count again. */
export function endTesting(glove: string): Promise<unknown> {
  return callService("gesture-controller", `gloves/${encodeURIComponent(glove)}/modes`, { method: "PUT", json: { testing: false } });
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
