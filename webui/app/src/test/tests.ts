/** The types and requests of accuracy tests. */
import type { CompositeSiteGesture, NewTest, Phase, PlainSiteGesture, TestState } from "~/api/generated/gesture-controller";
import { requestService } from "~/api/http";
import type { Tone } from "~/design/StatusBadge";

export type {
  Figures, Phase, TestReport as Report, TestSummary,
} from "~/api/generated/gesture-controller";
/** A gesture of the site; a composite one has no code. */
export type Gesture = PlainSiteGesture | CompositeSiteGesture;

export function isPlain(gesture: Gesture): gesture is PlainSiteGesture {
  return "code" in gesture;
}

export const phaseTone: Partial<Record<Phase, Tone>> = { finished: "ok", interrupted: "attention", stopped: "neutral" };

export const reportPath = (test: string): string => `tests/${encodeURIComponent(test)}/report`;
export const fileUrl = (test: string, kind: "csv" | "json"): string =>
  `/api/gesture-controller/tests/${encodeURIComponent(test)}/trials.${kind}`;

export function beginTest(plan: NewTest): Promise<TestState> {
  return requestService("gesture-controller", "tests", { method: "POST", json: plan });
}

export function leadTest(test: string, act: "continue" | "stop"): Promise<TestState> {
  return requestService("gesture-controller", `tests/${encodeURIComponent(test)}/${act}`, { method: "POST" });
}

export function deleteTest(test: string): Promise<unknown> {
  return requestService("gesture-controller", `tests/${encodeURIComponent(test)}`, { method: "DELETE" });
}

export function setTesting(glove: string, testing: boolean): Promise<unknown> {
  return requestService("gesture-controller", `gloves/${encodeURIComponent(glove)}/modes`, { method: "PUT", json: { testing } });
}
