/** The interval of a chart, and the points that are drawn in it; times are seconds since 1970. */
import type { ForecastPoint, PointView } from "~/api/generated/device-gateway";

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

/** How far ahead the forecast of a span looks, and in how many steps; a day has a whole number of them. */
export const HORIZONS: Readonly<Record<Span, { seconds: number; steps: number }>> = {
  hour: { seconds: 900, steps: 15 },
  day: { seconds: 21_600, steps: 24 },
  week: { seconds: 172_800, steps: 48 },
  month: { seconds: 604_800, steps: 42 },
};

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

/** Times, minima, maxima and means; a row of null breaks the line where values are missing. */
export type Columns = [number[], Column, Column, Column];
/** The columns of the values, then those of a forecast: low, high and mean. */
export type ForecastColumns = [...Columns, Column, Column, Column];
type Column = (number | null)[];

export function columnsOf(points: readonly PointView[], width: number): Columns {
  const steps = points.slice(1).map((point, nth) => point.t - (points[nth]?.t ?? 0)).sort((a, b) => a - b);
  const gap = Math.max(4 * (steps[Math.floor(steps.length / 2)] ?? 0), 3 * width);
  const columns: Columns = [[], [], [], []];
  let last: number | null = null;
  for (const { t, mean, min, max } of points) {
    if (last !== null && t - last > gap) pushRow(columns, [(last + t) / 2, null, null, null]);
    pushRow(columns, [t, min, max, mean]);
    last = t;
  }
  return columns;
}

/** The columns with a forecast, which begins at the last value, so that nothing is open between them. */
export function withForecast(columns: Columns, forecast: readonly ForecastPoint[]): ForecastColumns {
  const none = () => columns[0].map((): number | null => null);
  const joined: ForecastColumns = [[...columns[0]], [...columns[1]], [...columns[2]], [...columns[3]], none(), none(), none()];
  const last = columns[0].length - 1;
  const from = columns[0][last] ?? -Infinity;
  const ahead = forecast.filter(({ t }) => t > from);
  if (last >= 0 && ahead.length > 0) for (const nth of [4, 5, 6] as const) joined[nth][last] = columns[3][last] ?? null;
  for (const { t, low, high, mean } of ahead) pushRow(joined, [t, null, null, null, low, high, mean]);
  return joined;
}

function pushRow(columns: readonly Column[], row: readonly (number | null)[]): void {
  for (const [nth, value] of row.entries()) columns[nth]?.push(value);
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
