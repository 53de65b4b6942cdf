/** The audit logs of all services as one list: each service has its own chain and numbers. */
import { useInfiniteQuery } from "@tanstack/react-query";
import type { AuditVerification, AuditView } from "~/api/generated/accounts";
import { errorText, requestService, type Service } from "~/api/http";
import { queryClient } from "~/api/useServiceQuery";

export type { AuditVerification, AuditView };

export const AUDITED = ["accounts", "task-orchestrator", "gesture-controller", "trajectory-tool", "device-gateway", "alert-router", "study", "context-broker"] as const satisfies readonly Service[];
export type Audited = (typeof AUDITED)[number];
export const OUTCOMES = ["done", "refused", "failed"] as const;
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

export function servicesOf({ service }: AuditFilter): readonly Audited[] {
  return AUDITED.filter((one) => service === "" || service === one);
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

export function useAudit(filter: AuditFilter) {
  const query = queryOf(filter);
  const pages = useInfiniteQuery(
    {
      queryKey: ["audit", filter.service, query],
      queryFn: ({ pageParam }) =>
        Promise.all((pageParam === null ? servicesOf(filter) : AUDITED.filter((one) => one in pageParam)).map((service) => loadedFrom(service, query, pageParam?.[service]))),
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

/** The records of all chosen services in one file; services that cannot be read are named in an error. */
export async function exported(filter: AuditFilter, format: "csv" | "json"): Promise<string> {
  const query = queryOf(filter);
  const texts = await Promise.all(
    servicesOf(filter).map((service) => requestService<unknown>(service, `audit/export?format=${format}${query === "" ? "" : `&${query}`}`)),
  );
  if (format === "json") return JSON.stringify(texts.flat(), null, 1);
  const [first, ...others] = texts.map((text) => String(text).replace(/^\uFEFF/, ""));
  return `\uFEFF${[first ?? "", ...others.map((text) => text.slice(text.indexOf("\n") + 1))].join("")}`;
}

export interface Verified {
  service: Audited;
  result: AuditVerification | null;
  failure: string | null;
}

export function verified(filter: AuditFilter): Promise<Verified[]> {
  return Promise.all(
    servicesOf(filter).map((service) =>
      requestService<AuditVerification>(service, "audit/verification").then(
        (result) => ({ service, result, failure: null }),
        (error: unknown) => ({ service, result: null, failure: errorText(error) }),
      ),
    ),
  );
}
