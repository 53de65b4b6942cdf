/** Times, durations and rates as text in the language of the page. */

import { number } from "./numbers";

/** SI symbols are the same in all languages; only the day has a name. */
const days: Record<string, string> = { de: "d", fi: "vrk" };

/** "12 s ago" for a time in ms; a time in the future counts as now. */
export function ago(thenMs: number, nowMs: number, language: string): string {
  const text = span(Math.max(0, (nowMs - thenMs) / 1000), language);
  if (language.startsWith("de")) return `vor ${text}`;
  return language.startsWith("fi") ? `${text} sitten` : `${text} ago`;
}

/** "12 s", "3 min", "5 h", "2 d" for a duration in s. */
export function span(seconds: number, language: string): string {
  if (seconds < 60) return `${Math.floor(seconds)} s`;
  if (seconds < 3600) return `${Math.floor(seconds / 60)} min`;
  if (seconds < 86_400) return `${Math.floor(seconds / 3600)} h`;
  return `${Math.floor(seconds / 86_400)} ${days[language.slice(0, 2)] ?? "d"}`;
}

/** "850 ms", "2.5 s", "3 min 05 s", "1 h 12 min" for a duration in ms. */
export function duration(ms: number, language: string): string {
  if (ms < 1000) return `${Math.round(ms)} ms`;
  const seconds = ms / 1000;
  if (seconds < 60) return `${number(seconds, language, { maximumFractionDigits: 1 })} s`;
  const minutes = Math.floor(seconds / 60);
  if (minutes < 60) return `${minutes} min ${String(Math.floor(seconds % 60)).padStart(2, "0")} s`;
  return `${Math.floor(minutes / 60)} h ${String(minutes % 60).padStart(2, "0")} min`;
}

/** "32.4 /s" for a rate per second. */
export function rate(perSecond: number, language: string): string {
  const digits = perSecond < 10 ? 1 : 0;
  return `${number(perSecond, language, { maximumFractionDigits: digits })} /s`;
}

/** The exact time, in the time zone of the reader. */
export function exactTime(at: string, language: string): string {
  return new Date(at).toLocaleString(language, { dateStyle: "medium", timeStyle: "medium", hourCycle: "h23" });
}

/** "14:03" for a moment of the last day or later today, else with the date, in the time zone of the reader. */
export function clockTime(at: string, language: string, nowMs = Date.now()): string {
  const then = new Date(at);
  const agoMs = nowMs - then.getTime();
  const isRecent = agoMs >= 0 ? agoMs < 86_400_000 : then.toDateString() === new Date(nowMs).toDateString();
  return then.toLocaleString(language, { ...(isRecent ? {} : { dateStyle: "medium" }), timeStyle: "short", hourCycle: "h23" });
}
