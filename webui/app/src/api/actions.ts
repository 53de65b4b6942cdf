/** The acts that more than one page offers. */
import type { LiveEvent, ProcessView } from "~/live/messages";
import { request, requestService, type ProblemDetails } from "./http";

export function startProcess(definition: string, parameters: Record<string, unknown> = {}, key?: string): Promise<ProcessView> {
  const json = { definition, parameters, ...(key === undefined ? {} : { key }) };
  return requestService("task-orchestrator", "processes", { method: "POST", json });
}

export function retryTask(process: string, task: string, by: string): Promise<ProcessView> {
  const path = `processes/${encodeURIComponent(process)}/tasks/${encodeURIComponent(task)}/retry`;
  return requestService("task-orchestrator", path, { method: "POST", json: { by } });
}

export function cancelProcess(process: string, by: string): Promise<ProcessView> {
  return requestService("task-orchestrator", `processes/${encodeURIComponent(process)}/cancel`, { method: "POST", json: { by } });
}

export function startOperator(glove: string): Promise<unknown> {
  return request("operator", { method: "POST", json: { glove } });
}

export function stopOperator(): Promise<unknown> {
  return request("operator", { method: "DELETE" });
}

/** Make a glove known to the controller, so that its Tasks can be answered on the screen without it. */
export function declareGlove(glove: string, hand: "left" | "right" = "right"): Promise<unknown> {
  return requestService("gesture-controller", `gloves/${encodeURIComponent(glove)}`, { method: "PUT", json: { hand } });
}

/** What became of an act on many Alerts. */
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
