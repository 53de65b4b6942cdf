/** The actions that more than one page offers. */
import type { LiveEvent } from "~/live/messages";
import type { CancelRequest, MendRequest, MigrationOfAllRequest, MigrationOfAllView, MigrationRequest, MigrationView, MoveRequest, PausedProcesses, PauseRequest, ProcessStart, ProcessView, VariablesRequest } from "./generated/task-orchestrator";
import { request, requestService, type ProblemDetails } from "./http";

export function startProcess(definition: string, parameters: Record<string, unknown> = {}, more: Partial<ProcessStart> = {}): Promise<ProcessView> {
  const json: ProcessStart = { definition, parameters, ...more };
  return requestService("task-orchestrator", "processes", { method: "POST", json });
}

/** Let a token with an incident try again; a failed Task is posted again as a new Task. */
export function retryToken(process: string, token: string, decision: MendRequest): Promise<ProcessView> {
  return decide(process, `tokens/${encodeURIComponent(token)}/retry`, decision);
}

/** Let a token leave its element; the variables are the results. */
export function skipToken(process: string, token: string, decision: MendRequest): Promise<ProcessView> {
  return decide(process, `tokens/${encodeURIComponent(token)}/skip`, decision);
}

/** Move a token to another element of its scope. */
export function moveToken(process: string, token: string, decision: MoveRequest): Promise<ProcessView> {
  return decide(process, `tokens/${encodeURIComponent(token)}/move`, decision);
}

/** End a token where it is. */
export function cancelToken(process: string, token: string, decision: MendRequest): Promise<ProcessView> {
  return decide(process, `tokens/${encodeURIComponent(token)}/cancel`, decision);
}

/** Release what is reserved for a part of a process, though a token is within. */
export function releaseReservation(process: string, key: string, { by, why = null }: MendRequest): Promise<ProcessView> {
  return decide(process, `reservations/${encodeURIComponent(key)}/release`, { by, why });
}

export function setVariables(process: string, decision: VariablesRequest): Promise<ProcessView> {
  return decide(process, "variables", decision);
}

function decide(process: string, path: string, json: MendRequest): Promise<ProcessView> {
  return requestService("task-orchestrator", `processes/${encodeURIComponent(process)}/${path}`, { method: "POST", json });
}

export function cancelProcess(process: string, by: string): Promise<ProcessView> {
  const json: CancelRequest = { by };
  return requestService("task-orchestrator", `processes/${encodeURIComponent(process)}/cancel`, { method: "POST", json });
}

/** Continue a process in another version of its definition; with `dry` only report what differs. */
export function migrateProcess(process: string, json: MigrationRequest, dry = false): Promise<MigrationView> {
  return requestService("task-orchestrator", `processes/${encodeURIComponent(process)}/migration${dry ? "?dry=true" : ""}`, { method: "POST", json });
}

/** Continue the running processes of a version in another one, each if it can; with `dry` only report what differs. */
export function migrateProcesses(definition: string, json: MigrationOfAllRequest, dry = false): Promise<MigrationOfAllView> {
  return requestService("task-orchestrator", `definitions/${encodeURIComponent(definition)}/migration${dry ? "?dry=true" : ""}`, { method: "POST", json });
}

export type Pace = "pause" | "resume";

export function changePace(process: string, pace: Pace, json: PauseRequest): Promise<ProcessView> {
  return requestService("task-orchestrator", `processes/${encodeURIComponent(process)}/${pace}`, { method: "POST", json });
}

/** Pause or resume all processes, or those of a definition. */
export function changePaceOfAll(pace: Pace, json: PauseRequest, definition?: string): Promise<PausedProcesses> {
  const query = definition === undefined ? "" : `?definition=${encodeURIComponent(definition)}`;
  return requestService("task-orchestrator", `${pace}${query}`, { method: "POST", json });
}

export function startOperator(glove: string): Promise<unknown> {
  return request("operator", { method: "POST", json: { glove } });
}

export function stopOperator(): Promise<unknown> {
  return request("operator", { method: "DELETE" });
}

/** Declare a glove at the controller, so that its Tasks can be answered on the screen without it. */
export function declareGlove(glove: string, hand: "left" | "right" = "right"): Promise<unknown> {
  return requestService("gesture-controller", `gloves/${encodeURIComponent(glove)}`, { method: "PUT", json: { hand } });
}

/** The result of an action on many Alerts. */
export interface Outcome {
  done: string[];
  failed: ({ alert: string } & ProblemDetails)[];
}

export function acknowledge(alerts: readonly string[], by: string): Promise<Outcome> {
  return request("alerts/acknowledge", { method: "POST", json: { alerts, by } });
}

export function shelve(alerts: readonly string[], by: string, minutes: number): Promise<Outcome> {
  return request("alerts/shelve", { method: "POST", json: { alerts, by, minutes } });
}

export function unshelve(alerts: readonly string[], by: string): Promise<Outcome> {
  return request("alerts/unshelve", { method: "POST", json: { alerts, by } });
}

export function eventsAfter(after: number, limit = 500): Promise<LiveEvent[]> {
  return request(`events?after=${after}&limit=${limit}`);
}

export function eventsBefore(before: number, limit = 200): Promise<LiveEvent[]> {
  return request(`events?before=${before}&limit=${limit}`);
}
