/** The types and requests of the study service. */
import type { NewSession, SessionView as Session } from "~/api/generated/study";
import { requestService } from "~/api/http";

export type { SessionView as Session, StudyAnalysis as Analysis, SummaryView as Summary, WordingView as Wording } from "~/api/generated/study";
export type Language = Session["language"];
export const languages: readonly Language[] = ["en", "de", "fi"];

export const measures = ["mental", "physical", "temporal", "performance", "effort", "frustration", "raw", "weighted"] as const;

export const csvUrl = "/api/study/answers.csv";
export const pdfUrl = (language: string): string => `/api/study/report.pdf?language=${language}`;
export const sessionPath = (session: string): string => `sessions/${encodeURIComponent(session)}`;

export function beginSession(json: NewSession): Promise<Session> {
  return requestService("study", "sessions", { method: "POST", json });
}

export function answerStep(session: string, step: string, json: unknown): Promise<Session> {
  return requestService("study", `${sessionPath(session)}/steps/${step}`, { method: "POST", json });
}

export function deleteSession(session: string): Promise<unknown> {
  return requestService("study", sessionPath(session), { method: "DELETE" });
}
