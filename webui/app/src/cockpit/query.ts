/** The period and the definition that the cockpit shows, which the URL holds, and the requests for them. */
import { useMemo } from "react";
import { useNow } from "~/live/clock";
import { UnknownAddress, useChoice } from "~/route/choice";
import { useQueryParameter } from "~/route/queryParameter";

export const PERIODS = ["day", "week", "month", "year", "custom"] as const;
export type PeriodName = (typeof PERIODS)[number];

const HOUR_MS = 3_600_000;
const DAY_MS = 24 * HOUR_MS;
const LENGTHS_MS: Record<Exclude<PeriodName, "custom">, number> = { day: DAY_MS, week: 7 * DAY_MS, month: 30 * DAY_MS, year: 365 * DAY_MS };
/** The orchestrator counts by hour for so long; longer periods are shown by day. */
const MAX_HOURLY_MS = 91 * DAY_MS;
const BY_HOUR_MS = 3 * DAY_MS;

/** Times in ms since 1970; `untilMs` null: until now. */
export interface Period {
  sinceMs: number;
  untilMs: number | null;
}

export interface Scope {
  definition: string;
  /** "" for all versions. */
  version: string;
  period: Period;
}

/** The hours of a period that ends now, or the days from `from` to `to` ("2026-05-04") in the reader's time zone. */
export function periodOf(name: PeriodName, from: string, to: string, nowMs: number): Period {
  const hour = Math.floor(nowMs / HOUR_MS) * HOUR_MS;
  if (name !== "custom") return { sinceMs: hour + HOUR_MS - LENGTHS_MS[name], untilMs: null };
  const begin = startOfDay(from);
  const end = startOfDay(to);
  const untilMs = end === null ? null : nextDay(end);
  return { sinceMs: begin ?? hour + HOUR_MS - LENGTHS_MS.week, untilMs: untilMs !== null && untilMs > nowMs ? null : untilMs };
}

/** The query of a request for statistics. */
export function statisticsQuery(scope: Scope, more: Record<string, string> = {}): string {
  const query = new URLSearchParams(more);
  if (scope.definition !== "") query.set("definition", scope.definition);
  if (scope.version !== "") query.set("version", scope.version);
  query.set("since", new Date(scope.period.sinceMs).toISOString());
  if (scope.period.untilMs !== null) query.set("until", new Date(scope.period.untilMs).toISOString());
  return query.toString();
}

export interface Points {
  /** Begin of an hour or a day, in s since 1970, as plots have it. */
  at: number[];
  started: number[];
  completed: number[];
  failed: number[];
}

type Count = "started" | "completed" | "failed";
const COUNTS: readonly Count[] = ["started", "completed", "failed"];

export type PlotStep = "hour" | "day";

/** Whether a plot has a point an hour or a day, and which of them the orchestrator is asked for. */
export function stepsOf({ sinceMs, untilMs }: Period, nowMs: number): { shown: PlotStep; asked: PlotStep } {
  const lengthMs = (untilMs ?? nowMs) - sinceMs;
  return { shown: lengthMs <= BY_HOUR_MS ? "hour" : "day", asked: lengthMs <= MAX_HOURLY_MS ? "hour" : "day" };
}

/** The points of a plot; hours become days of the reader's time zone. */
export function pointsOf(given: readonly ({ at: string } & Record<Count, number>)[], shown: PlotStep): Points {
  const points: Points = { at: [], started: [], completed: [], failed: [] };
  for (const point of given) {
    const moment = new Date(point.at);
    if (shown === "day") moment.setHours(0, 0, 0, 0);
    const at = moment.getTime() / 1000;
    if (points.at.at(-1) !== at) {
      points.at.push(at);
      for (const count of COUNTS) points[count].push(0);
    }
    for (const count of COUNTS) points[count][points.at.length - 1] = (points[count].at(-1) ?? 0) + point[count];
  }
  return points;
}

/** The scope in the URL. It changes at the full hour, not with each second. */
export function useScope() {
  const [definition, setDefinition] = useQueryParameter("of");
  const [version, setVersion] = useQueryParameter("version");
  const [name, setPeriod] = useChoice("period", PERIODS, "week");
  const [from, setFrom] = useQueryParameter("from");
  const [to, setTo] = useQueryParameter("to");
  for (const [parameter, date] of Object.entries({ from, to })) {
    if (date !== "" && startOfDay(date) === null) throw new UnknownAddress(parameter, date);
  }
  const hour = Math.floor(useNow() / HOUR_MS) * HOUR_MS;
  const scope: Scope = useMemo(() => ({ definition, version, period: periodOf(name, from, to, hour) }), [definition, version, name, from, to, hour]);
  return { scope, name, from, to, setDefinition, setVersion, setPeriod, setFrom, setTo };
}

function startOfDay(date: string): number | null {
  const moment = /^\d{4}-\d\d-\d\d$/.test(date) ? new Date(`${date}T00:00:00`) : null;
  return moment === null || Number.isNaN(moment.getTime()) ? null : moment.getTime();
}

function nextDay(startMs: number): number {
  const moment = new Date(startMs);
  moment.setDate(moment.getDate() + 1);
  return moment.getTime();
}
