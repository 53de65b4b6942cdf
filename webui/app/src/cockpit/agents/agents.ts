/** What the table of agents says of an agent. */
import type { AgentView, ShiftView } from "~/api/generated/task-orchestrator";
import type { Tone } from "~/design/StatusBadge";
import { shortName } from "~/live/urn";

export type Standing = "unavailable" | "offShift" | "busy" | "idle";

export const STANDING_TONES: Record<Standing, Tone> = { unavailable: "stop", offShift: "neutral", busy: "accent", idle: "ok" };

/** Why an agent gets no further work, or that it is idle. */
export function standingOf(agent: Pick<AgentView, "unavailable" | "isOnShift" | "tasks">): Standing {
  if (agent.unavailable !== null) return "unavailable";
  if (agent.tasks.length > 0) return "busy";
  return agent.isOnShift ? "idle" : "offShift";
}

/** The share of its capacity that an agent uses. */
export function loadOf({ tasks, capacity }: Pick<AgentView, "tasks" | "capacity">): number {
  return tasks.length / Math.max(1, capacity ?? 1);
}

/** Whether a text is part of the name, a role or a skill of an agent. */
export function isFound(agent: Pick<AgentView, "id" | "roles" | "skills">, text: string): boolean {
  const wanted = text.trim().toLowerCase();
  return [shortName(agent.id), ...agent.roles, ...Object.keys(agent.skills)].some((word) => word.toLowerCase().includes(wanted));
}

/** "Mon–Fri 06:00–14:00": days in a row with the same times are one span; "" if there is no time without a shift. */
export function shiftsOf({ shifts }: Pick<AgentView, "shifts">, language: string): string {
  if (isAlways(shifts)) return "";
  const byTimes = new Map<string, number[]>();
  for (const shift of shifts) {
    const days = byTimes.get(timesOf(shift)) ?? [];
    byTimes.set(timesOf(shift), [...days, shift.weekday]);
  }
  return [...byTimes].map(([times, days]) => `${spansOf(days).map((span) => span.map((day) => dayName(day, language)).join("–")).join(", ")} ${times}`).join("; ");
}

/** Whether the shifts are whole days, one for each day of the week. */
function isAlways(shifts: readonly ShiftView[]): boolean {
  return new Set(shifts.map((shift) => shift.weekday)).size === 7 && shifts.every(({ begins, ends }) => begins === ends);
}

function timesOf({ begins, ends }: ShiftView): string {
  return `${begins}–${begins === ends && begins === "00:00" ? "24:00" : ends}`;
}

function spansOf(days: readonly number[]): number[][] {
  const spans: number[][] = [];
  for (const day of [...new Set(days)].sort((a, b) => a - b)) {
    const last = spans.at(-1);
    if (last?.at(-1) === day - 1) spans[spans.length - 1] = [last[0] ?? day, day];
    else spans.push([day]);
  }
  return spans;
}

function dayName(weekday: number, language: string): string {
  // 5 January 1970 was a Monday.
  return new Intl.DateTimeFormat(language, { weekday: "short", timeZone: "UTC" }).format(new Date((3 + weekday) * 86_400_000));
}
