/** The acts that more than one page offers. */
import type { LiveEvent, ProcessView } from "~/live/messages";
import { call, callService } from "./http";

export function startProcess(definition: string, parameters: Record<string, unknown> = {}, key?: string): Promise<ProcessView> {
  const json = { definition, parameters, ...(key === undefined ? {} : { key }) };
  return callService("task-orchestrator", "processes", { method: "POST", json });
}

export function retryTask(process: string, task: string, by: string): Promise<ProcessView> {
  const path = `processes/${encodeURIComponent(process)}/tasks/${encodeURIComponent(task)}/retry`;
  return callService("task-orchestrator", path, { method: "POST", json: { by } });
}

export function cancelProcess(process: string, by: string): Promise<ProcessView> {
  return callService("task-orchestrator", `processes/${encodeURIComponent(process)}/cancel`, { method: "POST", json: { by } });
}

export function startOperator(glove: string): Promise<unknown> {
  return call("operator", { method: "POST", json: { glove } });
}

export function stopOperator(): Promise<unknown> {
  return call("operator", { method: "DELETE" });
}

/** Make a glove known to the controller, so that its Tasks can be answered on the screen without it. */
export function declareGlove(glove: string, hand: "left" | "right" = "right"): Promise<unknown> {
  return callService("gesture-controller", `gloves/${encodeURIComponent(glove)}`, { method: "PUT", json: { hand } });
}

export function acknowledge(alert: string, by: string): Promise<unknown> {
  return call(`alerts/${encodeURIComponent(alert)}/acknowledge`, { method: "POST", json: { by } });
}

export function eventsAfter(after: number, limit = 500): Promise<LiveEvent[]> {
  return call(`events?after=${after}&limit=${limit}`);
}

export function eventsBefore(before: number, limit = 200): Promise<LiveEvent[]> {
  return call(`events?before=${before}&limit=${limit}`);
}
