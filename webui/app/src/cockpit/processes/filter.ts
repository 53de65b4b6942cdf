/** The filter of the list of processes, which the URL holds, and the requests for its pages. */
import { requestService } from "~/api/http";
import type { ProcessSummary } from "~/api/generated/task-orchestrator";
import type { Scope } from "../query";

export const STATES = ["incident", "unallocated", "inProgress", "paused", "completed", "failed"] as const;
export const TIMES = ["started", "ended"] as const;

export interface ListFilter {
  state: string;
  search: string;
  /** Conditions on variables, divided by semicolons. */
  variables: string;
  resource: string;
  /** "" for any time, else whether processes started or ended in the period that the page shows. */
  time: string;
  element: string;
}

/** The query of a list of processes, and of their event log. */
export function listQuery(filter: ListFilter, scope: Scope): URLSearchParams {
  const query = new URLSearchParams();
  const set = (name: string, value: string) => {
    if (value !== "") query.set(name, value);
  };
  set("definition", scope.definition);
  set("version", scope.version);
  if (filter.state === "incident" || filter.state === "unallocated") query.set(filter.state, "true");
  else set("status", filter.state);
  set("search", filter.search.trim());
  set("involves", filter.resource);
  set("element", filter.element);
  for (const condition of conditionsOf(filter.variables)) query.append("variable", condition);
  if (filter.time === "started" || filter.time === "ended") {
    query.set(`${filter.time}Since`, new Date(scope.period.sinceMs).toISOString());
    if (scope.period.untilMs !== null) query.set(`${filter.time}Until`, new Date(scope.period.untilMs).toISOString());
  }
  return query;
}

/** "a=1; b~x" is two conditions; a semicolon between quotation marks divides nothing. */
export function conditionsOf(text: string): string[] {
  return [...text.matchAll(/(?:"(?:\\.|[^"\\])*"|[^;])+/g)].map(([part]) => part.trim()).filter((part) => part !== "");
}

export const PAGE = 100;

export function processPage(query: string, before: string | null): Promise<ProcessSummary[]> {
  const page = new URLSearchParams(query);
  page.set("limit", String(PAGE));
  if (before !== null) page.set("before", before);
  return requestService("task-orchestrator", `processes?${page.toString()}`);
}
