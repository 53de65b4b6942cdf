/** The interval of a chart, and the points that are drawn in it; times are seconds since 1970. */
import type { PointView } from "~/api/generated/device-gateway";

export const SPANS = { hour: 3600, day: 86_400, week: 604_800, month: 2_592_000 } as const;
export type Span = keyof typeof SPANS;

export interface Interval {
  begin: number;
  end: number;
}

/** A zoomed interval has at least this length. */
const MIN_S = 10;
const MAX_S = 5 * 365 * 86_400;

export function isSpan(text: string): text is Span {
  return text in SPANS;
}

/** The interval of "1767225600-1767229200"; null for another text. */
export function intervalIn(text: string): Interval | null {
  const [begin, end, ...more] = text.split("-").map(Number);
  const isInterval = begin !== undefined && end !== undefined && more.length === 0 && Number.isFinite(begin) && Number.isFinite(end) && begin > 0 && begin < end;
  return isInterval ? { begin, end } : null;
}

export function intervalText({ begin, end }: Interval): string {
  return `${Math.round(begin)}-${Math.round(end)}`;
}

/** The last hour, day, week or month; it moves on in steps, so that the server is not asked all the time. */
export function lastInterval(span: Span, now: number): Interval {
  const step = refreshS(span);
  const end = Math.ceil(now / step) * step;
  return { begin: end - SPANS[span], end };
}

/** How often the chart of a span is loaded again. */
export function refreshS(span: Span): number {
  return Math.max(5, SPANS[span] / 720);
}

/** The interval around the same middle; a factor below 1 shows less. */
export function zoomed({ begin, end }: Interval, factor: number): Interval {
  const middle = (begin + end) / 2;
  const half = Math.min(Math.max((end - begin) * factor, MIN_S), MAX_S) / 2;
  return { begin: Math.max(1, middle - half), end: middle + half };
}

/** The interval moved by a part of its length: a negative one is earlier. */
export function moved({ begin, end }: Interval, part: number): Interval {
  const by = Math.max((end - begin) * part, 1 - begin);
  return { begin: begin + by, end: end + by };
}

/** Times, means, minima and maxima; a row of null breaks the line where values are missing. */
export type Columns = [number[], (number | null)[], (number | null)[], (number | null)[]];

export function columnsOf(points: readonly PointView[], width: number): Columns {
  const steps = points.slice(1).map((point, nth) => point.t - (points[nth]?.t ?? 0)).sort((a, b) => a - b);
  const gap = Math.max(4 * (steps[Math.floor(steps.length / 2)] ?? 0), 3 * width);
  const columns: Columns = [[], [], [], []];
  const push = (t: number, mean: number | null, min: number | null, max: number | null) => {
    columns[0].push(t);
    columns[1].push(mean);
    columns[2].push(min);
    columns[3].push(max);
  };
  let last: number | null = null;
  for (const { t, mean, min, max } of points) {
    if (last !== null && t - last > gap) push((last + t) / 2, null, null, null);
    push(t, mean, min, max);
    last = t;
  }
  return columns;
}

/** The least, the mean and the greatest of all values. */
export function summaryOf(points: readonly PointView[]): { min: number; mean: number; max: number } | null {
  if (points.length === 0) return null;
  const count = points.reduce((sum, { n }) => sum + n, 0);
  return {
    min: Math.min(...points.map(({ min }) => min)),
    mean: points.reduce((sum, { n, mean }) => sum + n * mean, 0) / count,
    max: Math.max(...points.map(({ max }) => max)),
  };
}
