/** Axis: the stretch of real time that the timeline shows, and round moments to mark on it. */

export interface Span {
  fromMs: number;
  toMs: number;
}

const SECOND = 1000;
const MINUTE = 60 * SECOND;
const HOUR = 60 * MINUTE;
const DAY = 24 * HOUR;

/** Steps that people count in. */
const STEPS = [
  0.1 * SECOND, 0.2 * SECOND, 0.5 * SECOND, SECOND, 2 * SECOND, 5 * SECOND, 10 * SECOND, 15 * SECOND, 30 * SECOND,
  MINUTE, 2 * MINUTE, 5 * MINUTE, 10 * MINUTE, 15 * MINUTE, 30 * MINUTE,
  HOUR, 2 * HOUR, 3 * HOUR, 6 * HOUR, 12 * HOUR, DAY, 2 * DAY, 7 * DAY, 30 * DAY,
];

/** The smallest round step that needs at most `most` marks for `lengthMs`. */
export function stepFor(lengthMs: number, most: number): number {
  const least = lengthMs / Math.max(1, most);
  return STEPS.find((step) => step >= least) ?? Math.ceil(least / DAY) * DAY;
}

/**
 * What the axis spans to show all of `fromMs` to `toMs`. While a process runs it ends at the next round
 * moment, so that the bars keep their place for a while instead of creeping together with every second.
 */
export function spanOf(fromMs: number, toMs: number, running: boolean): Span {
  const length = Math.max(SECOND, toMs - fromMs);
  if (!running) return { fromMs, toMs: fromMs + length * 1.02 };
  let room = 10 * SECOND;
  while (room < length) room *= room >= DAY ? 2 : 1.5;
  return { fromMs, toMs: fromMs + room };
}

/** The marks on a span: round moments in local time, `offsetMinutes` as `Date.getTimezoneOffset` has it. */
export function marksOf(span: Span, most: number, offsetMinutes: number): number[] {
  const step = stepFor(span.toMs - span.fromMs, most);
  const offset = offsetMinutes * MINUTE;
  const marks: number[] = [];
  const first = Math.ceil((span.fromMs - offset) / step) * step + offset;
  for (let nth = 0; first + nth * step <= span.toMs; nth++) marks.push(first + nth * step);
  return marks;
}

/** A moment of a day, as shop floors write it. */
export const CLOCK = { hour: "2-digit", minute: "2-digit", second: "2-digit", hourCycle: "h23" } as const;

/** How a mark is written: as precise as the step between marks needs it, no more. */
export function markFormat(stepMs: number): Intl.DateTimeFormatOptions {
  if (stepMs >= DAY) return { day: "numeric", month: "short" };
  if (stepMs >= MINUTE) return { hour: "2-digit", minute: "2-digit", hourCycle: "h23" };
  const whole: Intl.DateTimeFormatOptions = { ...CLOCK };
  return stepMs >= SECOND ? whole : { ...whole, fractionalSecondDigits: 1 };
}

/** Where a moment lies on the span: 0 at its begin, 100 at its end. */
export function percentAt(span: Span, ms: number): number {
  const share = (ms - span.fromMs) / (span.toMs - span.fromMs);
  return Math.round(Math.min(1, Math.max(0, share)) * 1e4) / 100;
}
