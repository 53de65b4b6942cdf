/** The event log: merging, filtering and export. */
import type { LiveEvent } from "~/live/messages";

/** The page keeps this many events; the export contains all. */
export const MAX_SHOWN = 2000;

export interface EventFilter {
  /** "" for all, "attention" for attention and stop, "stop" for stop only. */
  level: "" | "attention" | "stop";
  source: string;
  text: string;
}

/** Ascending severity. */
export const LEVELS: readonly LiveEvent["level"][] = ["info", "attention", "stop"];

/** The newest `max` of both lists, sorted by `seq`, each once. */
export function merged(current: readonly LiveEvent[], received: readonly LiveEvent[], max = MAX_SHOWN): readonly LiveEvent[] {
  if (received.length === 0) return current;
  const bySeq = new Map(current.map((event) => [event.seq, event]));
  const before = bySeq.size;
  for (const event of received) bySeq.set(event.seq, event);
  if (bySeq.size === before) return current;
  return [...bySeq.values()].sort((a, b) => a.seq - b.seq).slice(-max);
}

/** Whether an event matches; `text` is its text in the language of the page. */
export function passes(event: LiveEvent, filter: EventFilter, text: string): boolean {
  if (filter.level !== "" && LEVELS.indexOf(event.level) < LEVELS.indexOf(filter.level)) return false;
  if (filter.source !== "" && event.source !== filter.source) return false;
  const searched = filter.text.trim().toLowerCase();
  return searched === "" || `${text} ${event.source} ${event.text}`.toLowerCase().includes(searched);
}

/** The sources of the events, sorted. */
export function sourcesOf(events: readonly LiveEvent[]): string[] {
  return [...new Set(events.map((event) => event.source))].sort();
}

/** All stored events, read backwards page by page. */
export async function allEvents(page: (before: number) => Promise<LiveEvent[]>): Promise<readonly LiveEvent[]> {
  let all: LiveEvent[] = [];
  let before = Number.MAX_SAFE_INTEGER;
  for (;;) {
    const older = await page(before);
    const first = older[0];
    if (first === undefined || first.seq >= before) return all;
    before = first.seq;
    all = [...older, ...all];
  }
}

const columns = ["seq", "at", "level", "source", "key", "text"] as const;

/** The events as CSV (RFC 4180), with the English texts whatever the language of the page. */
export function csv(events: readonly LiveEvent[]): string {
  const rows = events.map((event) => columns.map((column) => cell(String(event[column]))).join(","));
  return [columns.join(","), ...rows, ""].join("\r\n");
}

function cell(text: string): string {
  // A spreadsheet would evaluate such a cell as a formula.
  const plain = /^[=+\-@\t\r]/.test(text) ? `'${text}` : text;
  return /[",\r\n]/.test(plain) ? `"${plain.replaceAll('"', '""')}"` : plain;
}
