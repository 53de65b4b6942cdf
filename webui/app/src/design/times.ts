/** Times and amounts as people say them, in their language. */

const steps: [number, Intl.RelativeTimeFormatUnit][] = [
  [60, "second"],
  [60, "minute"],
  [24, "hour"],
  [Infinity, "day"],
];

const formats = new Map<string, Intl.RelativeTimeFormat>();

/** "12 s ago" for a moment in ms; a moment that is not over yet counts as now. */
export function ago(thenMs: number, nowMs: number, language: string): string {
  let amount = Math.max(0, (nowMs - thenMs) / 1000);
  for (const [size, unit] of steps) {
    if (amount < size) return relative(language).format(-Math.floor(amount), unit);
    amount /= size;
  }
  return "";
}

function relative(language: string): Intl.RelativeTimeFormat {
  let format = formats.get(language);
  if (format === undefined) {
    format = new Intl.RelativeTimeFormat(language, { style: "narrow", numeric: "always" });
    formats.set(language, format);
  }
  return format;
}

/** "850 ms", "2.5 s", "3 min 05 s", "1 h 12 min" for a duration in ms. */
export function duration(ms: number, language: string): string {
  if (ms < 1000) return `${Math.round(ms)} ms`;
  const seconds = ms / 1000;
  if (seconds < 60) return `${seconds.toLocaleString(language, { maximumFractionDigits: 1 })} s`;
  const minutes = Math.floor(seconds / 60);
  if (minutes < 60) return `${minutes} min ${String(Math.floor(seconds % 60)).padStart(2, "0")} s`;
  return `${Math.floor(minutes / 60)} h ${String(minutes % 60).padStart(2, "0")} min`;
}

/** "32.4 /s" for something that happens so often a second. */
export function rate(perSecond: number, language: string): string {
  const digits = perSecond < 10 ? 1 : 0;
  return `${perSecond.toLocaleString(language, { maximumFractionDigits: digits })} /s`;
}
