/** REST of the services, through the proxy at `/api/<service>/<path>`. Error responses throw `ApiError`. */
import { localizedText } from "~/i18n/server";
import { sentence } from "~/live/readable";
import { loadAdmins, missingRight } from "~/session/rights";
import { currentSession } from "~/session/session";

export type Service = "context-broker" | "task-orchestrator" | "accounts" | "device-gateway" | "alert-router" | "gesture-controller" | "trajectory-tool" | "study" | "human-state" | "assistive-devices" | "whole-body-control" | "ros-bridge" | "webui";

/** Problem details (RFC 7807), with the further members of our services. */
export interface ProblemDetails {
  title: string;
  detail: string;
  status: number;
  [more: string]: unknown;
}

export class ApiError extends Error {
  readonly problem: ProblemDetails;

  constructor(problem: ProblemDetails) {
    super(problem.detail);
    this.name = "ApiError";
    this.problem = problem;
  }
}

/** The server could not be reached. */
export class NetworkError extends Error {
  constructor() {
    super("the server of this page does not answer; it may be starting, or the network is down");
    this.name = "NetworkError";
  }
}

/** The text of an error, in the language of the page if the server sent a code. */
export function errorText(error: unknown): string {
  if (error instanceof ApiError) return missingRight(error.problem) ?? sentence(localizedText(error.problem, "detail") ?? error.message);
  return sentence(error instanceof Error ? error.message : String(error));
}

export interface RequestOptions {
  method?: "GET" | "POST" | "PUT" | "PATCH" | "DELETE";
  json?: unknown;
  body?: BodyInit;
  type?: string;
  signal?: AbortSignal;
}

/** Request `path` (below `/api/`) and return the response: JSON if it is JSON, else text. */
export async function request<T>(path: string, { method = "GET", json, body, type, signal }: RequestOptions = {}): Promise<T> {
  const headers: Record<string, string> = { Accept: "application/json" };
  if (json !== undefined) headers["Content-Type"] = "application/json";
  if (type !== undefined) headers["Content-Type"] = type;
  const { csrf } = currentSession();
  if (csrf !== null && method !== "GET") headers["X-CSRF-Token"] = csrf;
  let answer: Response;
  try {
    const sent = json === undefined ? body : JSON.stringify(json);
    answer = await fetch(`/api/${path}`, {
      method,
      headers,
      ...(sent === undefined ? {} : { body: sent }),
      ...(signal === undefined ? {} : { signal }),
    });
  } catch (error) {
    if (signal?.aborted === true) throw error;
    throw new NetworkError();
  }
  const text = await answer.text();
  const isJson = (answer.headers.get("Content-Type") ?? "").includes("json");
  if (answer.status === 403) await loadAdmins(); // their names are in the text of the error
  if (!answer.ok) throw new ApiError(problemOf(answer, isJson ? (JSON.parse(text) as unknown) : text));
  return (isJson && text !== "" ? JSON.parse(text) : text) as T;
}

export function requestService<T>(service: Service, path: string, options?: RequestOptions): Promise<T> {
  return request<T>(`${service}/${path.replace(/^\//, "")}`, options);
}

/** Request a file (`path` below `/api/`), which a link cannot do where the server may refuse it with a reason. */
export async function requestFile(path: string): Promise<Blob> {
  let answer: Response;
  try {
    answer = await fetch(`/api/${path}`);
  } catch {
    throw new NetworkError();
  }
  if (answer.ok) return answer.blob();
  const text = await answer.text();
  const isJson = (answer.headers.get("Content-Type") ?? "").includes("json");
  throw new ApiError(problemOf(answer, isJson ? (JSON.parse(text) as unknown) : text));
}

function problemOf(answer: Response, body: unknown): ProblemDetails {
  const received = typeof body === "object" && body !== null ? (body as Partial<ProblemDetails>) : {};
  const title = received.title ?? answer.statusText;
  return { ...received, title, detail: received.detail ?? title, status: answer.status };
}
