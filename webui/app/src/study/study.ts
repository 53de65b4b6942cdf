/** The types and requests of the study service. */
import { requestService } from "~/api/http";

export type Condition = "personal" | "predefined";
export type Language = "en" | "de" | "fi";
export const languages: readonly Language[] = ["en", "de", "fi"];

export interface Session {
  id: string;
  study: string;
  pseudonym: string;
  language: Language;
  glove: string | null;
  person: string | null;
  step: string;
  stepNumber: number;
  steps: number;
  first: Condition | null;
  condition: Condition | null;
  /** Which of each two scales contributed more is asked in this order. */
  pairs: [string, string][] | null;
  consentVersion: string;
  beganAt: string;
  endedAt: string | null;
}

interface Scale {
  title: string;
  ask: string;
  low: string;
  high: string;
}

/** What participants read, in their own language. */
export interface Wording {
  consent: { title: string; text: string[]; agree: string; decline: string };
  steps: {
    introduction: { title: string; text: string };
    sample: { title: string; text: string };
    interaction: Record<Condition, { title: string; text: string }>;
    preference: { title: string; text: string };
  };
  preference: Record<"personal" | "predefined" | "none" | "recalibrated" | "comment", string>;
  introduction: Record<"age" | "experience" | "low" | "medium" | "high", string>;
  /** `source`: whose wording it is, and whether it has been validated. */
  sus: { title: string; source: string; ask: string; disagree: string; agree: string; items: string[] };
  tlx: { title: string; source: string; ask: string; choose: string; scales: Record<string, Scale> };
  scales: string[];
  scaleStep: number;
}

export interface Summary {
  n: number;
  mean: number | null;
  sd: number | null;
  /** `low` and `high` are where the whiskers end. */
  box: { min: number; q1: number; median: number; q3: number; max: number; low: number; high: number; outliers: number[] } | null;
}

interface Test {
  p?: number;
  u?: number;
  t?: number;
  df?: number;
  effect?: number;
}

export interface Analysis {
  participants: number;
  finished: number;
  personalFirst: number;
  predefinedFirst: number;
  preference: Record<"personal" | "predefined" | "none", number>;
  sus: Summary & { grade: string | null; scores: number[]; test: Test };
  tlx: Record<string, { personal: Summary; predefined: Summary; test: Test; paired: Test }>;
}

export const measures = ["mental", "physical", "temporal", "performance", "effort", "frustration", "raw", "weighted"] as const;

export const csvUrl = "/api/study/answers.csv";
export const pdfUrl = (language: string): string => `/api/study/report.pdf?language=${language}`;
export const sessionPath = (session: string): string => `sessions/${encodeURIComponent(session)}`;

export function beginSession(json: { pseudonym?: string; language: Language; glove?: string; person?: string }): Promise<Session> {
  return requestService("study", "sessions", { method: "POST", json });
}

export function answerStep(session: string, step: string, json: unknown): Promise<Session> {
  return requestService("study", `${sessionPath(session)}/steps/${step}`, { method: "POST", json });
}

export function deleteSession(session: string): Promise<unknown> {
  return requestService("study", sessionPath(session), { method: "DELETE" });
}
