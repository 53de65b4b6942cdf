/** The audit logs of all services as one list: each service has its own chain and numbers. */
import { useInfiniteQuery } from "@tanstack/react-query";
import type { TFunction } from "i18next";
import type { AuditVerification, AuditView } from "~/api/generated/accounts";
import { errorText, requestService, type Service } from "~/api/http";
import { queryClient } from "~/api/useServiceQuery";

export type { AuditVerification, AuditView };

export const AUDITED = ["accounts", "task-orchestrator", "gesture-controller", "trajectory-tool", "device-gateway", "alert-router", "study", "human-state", "assistive-devices", "whole-body-control", "ros-bridge", "context-broker", "webui"] as const satisfies readonly Service[];
export type Audited = (typeof AUDITED)[number];
/** Services that an installation may do without: they are read while they run, or if the filter names them. */
const OPTIONAL: ReadonlySet<string> = new Set<Audited>(["human-state", "assistive-devices", "whole-body-control", "ros-bridge"]);
export const OUTCOMES = ["done", "refused", "failed", "intended"] as const;
const PAGE = 100;

export interface AuditFilter {
  service: string;
  subject: string;
  action: string;
  resource: string;
  outcome: string;
  /** Days, as 2026-05-04; both are included. */
  from: string;
  to: string;
}

/** The part of a service that was loaded; `before` is null if it has no older records. */
export interface Loaded {
  service: Audited;
  records: readonly AuditView[];
  before: number | null;
  failure: string | null;
}

type Cursor = Partial<Record<Audited, number>>;

/** The services that a filter chooses; `running` are the names of those that the page server sees. */
export function servicesOf({ service }: AuditFilter, running: readonly string[]): readonly Audited[] {
  return AUDITED.filter((one) => (service === "" ? !OPTIONAL.has(one) || running.includes(one) : service === one));
}

const ROUTE = /^(GET|HEAD|POST|PUT|PATCH|DELETE|WebSocket) \/?(.*)$/;

/** The method and the fixed words of a route, "POST /tasks/{task_id}/claim": ["POST", "tasks claim"]; null for other actions. */
export function routeOf(action: string): { method: string; words: string[] } | null {
  const [, method, path] = ROUTE.exec(action) ?? [];
  if (method === undefined || path === undefined) return null;
  return { method, words: path.split("/").filter((part) => part !== "" && !part.startsWith("{")) };
}

/** The words for an action, which is one of accounts or a route of a service. */
export function actionText(t: TFunction<["accounts", "common"]>, action: string): string {
  const route = routeOf(action);
  if (route === null) return t(`audit.actions.${action}`, { defaultValue: action });
  const { method, words } = route;
  const what = words.join(" › ");
  return t(`audit.routes.known.${[method, ...words].join("_")}`, { defaultValue: t(`audit.routes.method.${method}`, { what, defaultValue: action }) });
}

/** What a subject without a name was: its name was forgotten with the account, its id says what it is. */
export function unnamedKind(subject: string): "link" | "user" | "token" | "other" {
  if (subject.startsWith("link-")) return "link";
  if (subject.startsWith("user-")) return "user";
  return /^(device|script|service)-/.test(subject) ? "token" : "other";
}

/** The words for an outcome: an intent without one differs from an intent whose outcome has a record of its own. */
export function outcomeOf({ outcome, endedBy }: Pick<AuditView, "outcome" | "endedBy">): string {
  return outcome === "intended" && endedBy === null ? "unknown" : outcome;
}

/** The query of a filter, for records and exports; days are those of the reader. */
export function queryOf({ subject, action, resource, outcome, from, to }: AuditFilter): string {
  const query = new URLSearchParams();
  if (subject !== "") query.set("subject", subject);
  if (action.trim() !== "") query.set("action", action.trim());
  if (resource.trim() !== "") query.set("resource", resource.trim());
  if (outcome !== "") query.set("outcome", outcome);
  const [since, until] = [startOf(from), startOf(to, 1)];
  if (since !== null) query.set("since", String(since));
  if (until !== null) query.set("until", String(until));
  return query.toString();
}

function startOf(day: string, later = 0): number | null {
  const [year, month, date] = day.split("-").map(Number);
  const ms = year === undefined || month === undefined || date === undefined ? NaN : new Date(year, month - 1, date + later).getTime();
  return Number.isNaN(ms) ? null : ms;
}

/**
 * The records that are certain to be complete, the newest first: nothing older than the oldest loaded record of
 * a service that has more, since an unloaded record may be between.
 */
export function merged(pages: readonly (readonly Loaded[])[]): AuditView[] {
  const all = pages.flatMap((page) => page.flatMap(({ records }) => records));
  const open = (pages.at(-1) ?? []).filter(({ before }) => before !== null).map(({ records }) => records.at(-1)?.at ?? "");
  const certainFrom = open.reduce((latest, at) => (at > latest ? at : latest), "");
  return all.filter(({ at }) => at >= certainFrom).sort((a, b) => (a.at === b.at ? b.seq - a.seq : a.at < b.at ? 1 : -1));
}

async function loadedFrom(service: Audited, query: string, before: number | undefined): Promise<Loaded> {
  const cursor = before === undefined ? "" : `&before=${before}`;
  try {
    const records = await requestService<AuditView[]>(service, `audit?limit=${PAGE}${cursor}${query === "" ? "" : `&${query}`}`);
    return { service, records, before: records.length < PAGE ? null : (records.at(-1)?.seq ?? null), failure: null };
  } catch (error) {
    return { service, records: [], before: null, failure: errorText(error) };
  }
}

export function useAudit(filter: AuditFilter, services: readonly Audited[]) {
  const query = queryOf(filter);
  const pages = useInfiniteQuery(
    {
      queryKey: ["audit", services.join(), query],
      queryFn: ({ pageParam }) =>
        Promise.all((pageParam === null ? services : AUDITED.filter((one) => one in pageParam)).map((service) => loadedFrom(service, query, pageParam?.[service]))),
      initialPageParam: null as Cursor | null,
      getNextPageParam: (page: readonly Loaded[]) => {
        const next = Object.fromEntries(page.flatMap(({ service, before }) => (before === null ? [] : [[service, before]]))) as Cursor;
        return Object.keys(next).length === 0 ? undefined : next;
      },
    },
    queryClient,
  );
  const loaded = pages.data?.pages;
  return {
    records: loaded === undefined ? null : merged(loaded),
    failures: (loaded?.[0] ?? []).flatMap(({ service, failure }) => (failure === null ? [] : [{ service, failure }])),
    loadOlder: () => {
      if (pages.hasNextPage && !pages.isFetching) void pages.fetchNextPage();
    },
  };
}

export interface Failure {
  service: Audited;
  failure: string;
}

/** A file with audit records; `missing` are the services that could not be read, which its name lists. */
export interface Exported {
  name: string;
  text: string;
  missing: readonly Failure[];
}

/** The records of `services` in one file, by time, with the `names` of subjects that only accounts knows. Throws if none can be read. */
export async function exported(filter: AuditFilter, services: readonly Audited[], format: "csv" | "json", names: ReadonlyMap<string, string>): Promise<Exported> {
  const query = queryOf(filter);
  const lists = await Promise.all(
    services.map((service) =>
      requestService<AuditView[]>(service, `audit/export?format=json${query === "" ? "" : `&${query}`}`).then(
        (records) => ({ service, records, failure: null }),
        (error: unknown) => ({ service, records: [], failure: errorText(error) }),
      ),
    ),
  );
  const missing = lists.flatMap(({ service, failure }) => (failure === null ? [] : [{ service, failure }]));
  const [first] = missing;
  if (first !== undefined && missing.length === services.length) throw new Error(first.failure);
  const records = lists
    .flatMap((list) => list.records)
    .map((record) => ({ ...record, subjectName: record.subjectName ?? names.get(record.subject) ?? null, resourceName: record.resourceName ?? names.get(record.resource) ?? null }))
    .sort((a, b) => (a.at === b.at ? a.seq - b.seq : a.at < b.at ? -1 : 1));
  return {
    name: `${["audit", ...missing.map(({ service }) => `without-${service}`)].join("-")}.${format}`,
    text: format === "json" ? JSON.stringify(records, null, 1) : csvOf(records),
    missing,
  };
}

const COLUMNS = ["service", "seq", "at", "subject", "action", "resource", "outcome", "method", "text", "hash", "intent", "endedBy", "subjectName", "resourceName"] as const satisfies readonly (keyof AuditView)[];

/** A table as the services write it: with a mark for spreadsheets, and no cell that one would run as a formula. */
export function csvOf(records: readonly AuditView[]): string {
  const cell = (value: string | number | null) => {
    const text = typeof value === "string" && /^[=+\-@\t\r]/.test(value) ? `'${value}` : String(value ?? "");
    return /[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text;
  };
  const lines = [COLUMNS.join(","), ...records.map((record) => COLUMNS.map((column) => cell(record[column])).join(","))];
  return `\uFEFF${lines.map((line) => `${line}\r\n`).join("")}`;
}

export interface Verified {
  service: Audited;
  result: AuditVerification | null;
  failure: string | null;
}

export function verified(services: readonly Audited[]): Promise<Verified[]> {
  return Promise.all(
    services.map((service) =>
      requestService<AuditVerification>(service, "audit/verification").then(
        (result) => ({ service, result, failure: null }),
        (error: unknown) => ({ service, result: null, failure: errorText(error) }),
      ),
    ),
  );
}
