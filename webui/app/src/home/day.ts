/** The figures of the day, and what of yesterday they may be compared with. */
import type { PeriodStatistics } from "~/api/generated/task-orchestrator";

const DAY_MS = 86_400_000;
/** Yesterday is counted until this time of day, rounded down to so many ms: a request every few minutes. */
const ROUND_MS = 300_000;
/** From so many processes on, a median may be compared with another one. */
export const MIN_FOR_COMPARISON = 3;

/** The start of the day of `now` (in ms), in the local time zone. */
export function startOfDay(now: number): string {
  const day = new Date(now);
  day.setHours(0, 0, 0, 0);
  return day.toISOString();
}

/** Yesterday from midnight until this time of day, in the local time zone. */
export function untilNowYesterday(now: number): { since: string; until: string } {
  const until = new Date(Math.floor(now / ROUND_MS) * ROUND_MS);
  until.setDate(until.getDate() - 1);
  return { since: startOfDay(until.getTime()), until: until.toISOString() };
}

/** Yesterday, if it may be compared: the cell was there from midnight on, and something ended. */
export function comparable(yesterday: PeriodStatistics | null, asked: string): PeriodStatistics | null {
  if (yesterday === null || Date.parse(yesterday.since) > Date.parse(asked)) return null;
  return yesterday.completed + yesterday.failed === 0 ? null : yesterday;
}

/** When the cell began, if that was today. */
export function beganToday(today: PeriodStatistics | null, midnight: string): string | null {
  return today !== null && Date.parse(today.since) > Date.parse(midnight) && Date.parse(today.since) - Date.parse(midnight) < DAY_MS ? today.since : null;
}
