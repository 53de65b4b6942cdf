/** REST through the one door: `/api/<service>/<path>`. What is refused comes as a `Refusal` in plain words. */
import { wordsIn } from "~/i18n/server";

export type Service = "context-broker" | "task-orchestrator" | "gesture-controller" | "trajectory-tool" | "ros-bridge";

/** Problem details (RFC 7807) as our services answer them, with what they add. */
export interface ProblemDetails {
  title: string;
  detail: string;
  status: number;
  [more: string]: unknown;
}

export class Refusal extends Error {
  readonly problem: ProblemDetails;

  constructor(problem: ProblemDetails) {
    super(problem.detail);
    this.name = "Refusal";
    this.problem = problem;
  }
}

/** The server could not be reached at all. */
export class Unreachable extends Error {
  constructor() {
    super("the server of this page does not answer; it may be starting, or the network is down");
    this.name = "Unreachable";
  }
}

/** Say what went wrong, in the language of the page where the server gave a code. */
export function describe(error: unknown): string {
  if (error instanceof Refusal) return wordsIn(error.problem, "detail") ?? error.message;
  return error instanceof Error ? error.message : String(error);
}

export interface Call {
  method?: "GET" | "POST" | "PUT" | "PATCH" | "DELETE";
  json?: unknown;
  body?: BodyInit;
  type?: string;
  signal?: AbortSignal;
}

/** Call `path` (from `/api/`) and return what it answers: JSON, or text where it is no JSON. */
export async function call<T>(path: string, { method = "GET", json, body, type, signal }: Call = {}): Promise<T> {
  const headers: Record<string, string> = { Accept: "application/json" };
  if (json !== undefined) headers["Content-Type"] = "application/json";
  if (type !== undefined) headers["Content-Type"] = type;
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
    throw new Unreachable();
  }
  const text = await answer.text();
  const isJson = (answer.headers.get("Content-Type") ?? "").includes("json");
  if (!answer.ok) throw new Refusal(problemOf(answer, isJson ? (JSON.parse(text) as unknown) : text));
  return (isJson && text !== "" ? JSON.parse(text) : text) as T;
}

export function callService<T>(service: Service, path: string, options?: Call): Promise<T> {
  return call<T>(`${service}/${path.replace(/^\//, "")}`, options);
}

function problemOf(answer: Response, body: unknown): ProblemDetails {
  const told = typeof body === "object" && body !== null ? (body as Partial<ProblemDetails>) : {};
  const title = told.title ?? answer.statusText;
  return { ...told, title, detail: told.detail ?? title, status: answer.status };
}
