/** The event log as a list one reads: joined, filtered, held in its place, taken along as a file. */
import type { LiveEvent } from "~/live/messages";

/** More than this nobody scrolls through; an export has them all. */
export const MAX_SHOWN = 2000;

export interface EventFilter {
  /** "" for all, "attention" for attention and stop, "stop" for stop alone. */
  level: "" | "attention" | "stop";
  source: string;
  text: string;
}

const rank: Record<LiveEvent["level"] | "", number> = { "": 0, info: 0, attention: 1, stop: 2 };

/** Two runs of events as one, by `seq`, each once, the newest `most` of them. */
export function gathered(known: readonly LiveEvent[], news: readonly LiveEvent[], most = MAX_SHOWN): readonly LiveEvent[] {
  if (news.length === 0) return known;
  const bySeq = new Map(known.map((event) => [event.seq, event]));
  const before = bySeq.size;
  for (const event of news) bySeq.set(event.seq, event);
  if (bySeq.size === before) return known;
  return [...bySeq.values()].sort((a, b) => a.seq - b.seq).slice(-most);
}

/** Whether an event passes; `said` is what the page says of it, in the language of the page. */
export function passes(event: LiveEvent, filter: EventFilter, said: string): boolean {
  if (rank[event.level] < rank[filter.level]) return false;
  if (filter.source !== "" && event.source !== filter.source) return false;
  const wanted = filter.text.trim().toLowerCase();
  return wanted === "" || `${said} ${event.source} ${event.text}`.toLowerCase().includes(wanted);
}

/**
 * What a reader sees: everything while the newest is visible (`upTo` null), else only what was there when
 * they began to read, and how many have come since.
 */
export function held(events: readonly LiveEvent[], upTo: number | null): { shown: LiveEvent[]; waiting: number } {
  const shown = events.filter((event) => upTo === null || event.seq <= upTo);
  return { shown: shown.reverse(), waiting: events.length - shown.length };
}

/** All places that events come from, by name. */
export function sourcesOf(events: readonly LiveEvent[]): string[] {
  return [...new Set(events.map((event) => event.source))].sort();
}

/** All events that are kept, read backwards page by page. */
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

/** The events for a spreadsheet: RFC 4180, the English words, so that files from all screens are alike. */
export function csv(events: readonly LiveEvent[]): string {
  const rows = events.map((event) => columns.map((column) => cell(String(event[column]))).join(","));
  return [columns.join(","), ...rows, ""].join("\r\n");
}

function cell(text: string): string {
  // A spreadsheet takes a cell that begins so for a formula.
  const plain = /^[=+\-@\t\r]/.test(text) ? `'${text}` : text;
  return /[",\r\n]/.test(plain) ? `"${plain.replaceAll('"', '""')}"` : plain;
}
