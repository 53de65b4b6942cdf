/** The actions of operators: pause, resume, complete by hand. Other pages share start and retry (`~/api/actions`). */
import { requestService } from "~/api/http";
import type { Outcome } from "~/live/messages";

export function pauseGlove(glove: string): Promise<unknown> {
  return requestService("gesture-controller", `gloves/${encodeURIComponent(glove)}/pause`, { method: "POST" });
}

export function resumeGlove(glove: string): Promise<unknown> {
  return requestService("gesture-controller", `gloves/${encodeURIComponent(glove)}/resume`, { method: "POST" });
}

/**
* Answer `task`, which must be the one that was visible when the button was pressed.
 * With another outcome than `ok` it ends failed, unless its definition handles outcomes.
 */
export function answerByHand(glove: string, task: string | undefined, by: string, outcome: Outcome = "ok", note = ""): Promise<unknown> {
  const outcomeFields = outcome === "ok" ? {} : { outcome, ...(note === "" ? {} : { note }) };
  return requestService("gesture-controller", `gloves/${encodeURIComponent(glove)}/complete`, { method: "POST", json: { by, task, ...outcomeFields } });
}

/** Give the PIN that `task` demands; then a gesture or the screen answers it. */
export function givePin(glove: string, task: string | undefined, pin: string): Promise<unknown> {
  return requestService("gesture-controller", `gloves/${encodeURIComponent(glove)}/pin`, { method: "POST", json: { pin, ...(task === undefined ? {} : { task }) } });
}

/** Leave testing mode: gestures count again. */
export function endTesting(glove: string): Promise<unknown> {
  return requestService("gesture-controller", `gloves/${encodeURIComponent(glove)}/modes`, { method: "PUT", json: { testing: false } });
}

/**
 * Request that the performer of `task` pauses or resumes. The request has no timestamp, because the clock of
 * a browser is not reliable; the newest request counts.
 */
export function requestStatus(task: string, status: "paused" | "inProgress"): Promise<unknown> {
  return requestService("context-broker", `ngsi-ld/v1/entities/${encodeURIComponent(task)}/attrs`, {
    method: "POST",
    json: { requestedStatus: { type: "Property", value: status } },
  });
}
