/** What a person does with a Task of the tasklist. */
import type {
  ClaimRequest, CommentRequest, CompleteRequest, DeclineRequest, FormData, ReturnRequest, TaskComment, TaskDetails, TaskForm,
} from "~/api/generated/task-orchestrator";
import { requestService } from "~/api/http";

function post<T>(path: string, json: unknown): Promise<T> {
  return requestService("task-orchestrator", path, { method: "POST", json });
}

const of = (task: string) => `tasks/${encodeURIComponent(task)}`;

export function claimTask(task: string, request: ClaimRequest): Promise<TaskDetails> {
  return post(`${of(task)}/claim`, request);
}

export function returnTask(task: string, request: ReturnRequest): Promise<TaskDetails> {
  return post(`${of(task)}/return`, request);
}

export function declineTask(task: string, request: DeclineRequest): Promise<TaskDetails> {
  return post(`${of(task)}/decline`, request);
}

export function completeTask(task: string, request: CompleteRequest): Promise<TaskDetails> {
  return post(`${of(task)}/complete`, request);
}

/** The form for the values typed so far: conditions and expressions are evaluated by the server. */
export function formOf(task: string, request: FormData): Promise<TaskForm | null> {
  return post(`${of(task)}/form`, request);
}

/** The id makes a repeated request harmless. */
export function commentOnTask(task: string, request: CommentRequest): Promise<TaskComment> {
  return post(`${of(task)}/comments`, request);
}

export function commentOnProcess(process: string, request: CommentRequest): Promise<TaskComment> {
  return post(`processes/${encodeURIComponent(process)}/comments`, request);
}
