/** What a person does with a Task of the tasklist. */
import { request } from "~/api/http";
import type { Outcome, TasklistView } from "~/live/messages";

export function claimTask(task: string, by: string): Promise<TasklistView> {
  return request(`tasks/${encodeURIComponent(task)}/claim`, { method: "POST", json: { by } });
}

export function returnTask(task: string, by: string): Promise<TasklistView> {
  return request(`tasks/${encodeURIComponent(task)}/return`, { method: "POST", json: { by } });
}

export interface Result {
  outcome: Outcome;
  note: string;
  outputs: Record<string, unknown>;
}

export function completeTask(task: string, by: string, result: Result): Promise<unknown> {
  return request(`tasks/${encodeURIComponent(task)}/complete`, { method: "POST", json: { by, ...result } });
}
