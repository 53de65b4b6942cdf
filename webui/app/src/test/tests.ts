/** Accuracy tests as the gesture controller has them. */
import { requestService } from "~/api/http";

export type Phase = "break" | "rest" | "asked" | "noted" | "interrupted" | "stopped" | "finished";
export type Outcome = "right" | "corrected" | "missed";

export interface TestSummary {
  id: string;
  glove: string;
  person: string | null;
  phase: Phase;
  reason: string;
  beganAt: string;
  endedAt: string | null;
  gestures: string[];
  rounds: number;
  trials: number;
  seed: number;
}

export interface Figures {
  trials: number;
  right: number;
  corrected: number;
  missed: number;
  accuracy: number | null;
  /** The 95 % interval of Wilson. */
  interval: [number, number] | null;
  medianMs: number | null;
  p95Ms: number | null;
}

export interface Report {
  test: TestSummary;
  table: {
    problematic: { gesture: string; interactions: number }[];
    successfulInteractions: number;
    problematicInteractions: number;
    accuracy: number | null;
  };
  overall: Figures;
  gestures: (Figures & { gesture: string; code: string })[];
  confusion: { asked: string[]; recognized: string[]; counts: number[][] };
}

export interface Gesture {
  name: string;
  /** Those that are composed of two have none. */
  code?: string;
}

export interface Plan {
  glove: string;
  gestures?: string[];
  rounds: number;
  breaks: boolean;
}

export const reportPath = (test: string): string => `tests/${encodeURIComponent(test)}/report`;
export const fileUrl = (test: string, kind: "csv" | "json"): string =>
  `/api/gesture-controller/tests/${encodeURIComponent(test)}/trials.${kind}`;

export function beginTest(plan: Plan): Promise<TestSummary> {
  return requestService("gesture-controller", "tests", { method: "POST", json: plan });
}

export function leadTest(test: string, act: "continue" | "stop"): Promise<TestSummary> {
  return requestService("gesture-controller", `tests/${encodeURIComponent(test)}/${act}`, { method: "POST" });
}

export function deleteTest(test: string): Promise<unknown> {
  return requestService("gesture-controller", `tests/${encodeURIComponent(test)}`, { method: "DELETE" });
}

export function setTesting(glove: string, testing: boolean): Promise<unknown> {
  return requestService("gesture-controller", `gloves/${encodeURIComponent(glove)}/modes`, { method: "PUT", json: { testing } });
}
