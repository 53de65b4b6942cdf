/**
 * Rows: the list of definitions and processes. It keeps its place while somebody is in it: what is new is
 * counted and waits, what has ended stays where it stood.
 */
import type { DefinitionView, ProcessView } from "~/api/generated/task-orchestrator";
import { processState, type ProcessState } from "~/live/processState";

/** A process in a line, as the live view and the orchestrator's list both have it. */
export type ProcessRow = Pick<
  ProcessView,
  "id" | "name" | "definition" | "version" | "title" | "key" | "status" | "reason" | "startedAt" | "endedAt"
> &
  Partial<Pick<ProcessView, "tasks" | "incidents">>;

export const SORT_ORDERS = ["newest", "oldest", "name", "key"] as const;
export type ProcessSorting = (typeof SORT_ORDERS)[number];

/** The filter of the list; "" matches all. */
export interface ProcessFilter {
  /** A status, or "incident". */
  status: string;
  /** "bin-picking" or, with a version, "bin-picking@2". */
  definition: string;
  /** The URN of a person or a resource. */
  involves: string;
}

export interface Sections {
  running: readonly ProcessRow[];
  ended: readonly ProcessRow[];
}

export const MAX_ENDED = 2000;

/** Live processes and the history read so far, each once; the live one counts. The newest first, unless asked otherwise. */
export function together(live: readonly ProcessRow[], history: readonly ProcessRow[], sorting: ProcessSorting = "newest"): Sections {
  const byId = new Map<string, ProcessRow>();
  for (const row of history) byId.set(row.id, row);
  for (const row of live) byId.set(row.id, row);
  const all = [...byId.values()];
  return {
    running: sortRows(all.filter((row) => row.endedAt === null), sorting),
    ended: sortRows(all.filter((row) => row.endedAt !== null), sorting),
  };
}

function sortRows(rows: ProcessRow[], sorting: ProcessSorting): ProcessRow[] {
  const when = (row: ProcessRow) => row.endedAt ?? row.startedAt;
  return rows.sort((a, b) => {
    const newest = compare(when(b), when(a), a.id, b.id);
    if (sorting === "oldest") return compare(when(a), when(b), a.id, b.id);
    if (sorting === "name") return a.name.localeCompare(b.name, undefined, { numeric: true }) || newest;
    // Processes without a key come last.
    if (sorting === "key") return Number(a.key === null) - Number(b.key === null) || (a.key ?? "").localeCompare(b.key ?? "", undefined, { numeric: true }) || newest;
    return newest;
  });
}

/** Whether a process passes; of one whose Tasks are not known here, the orchestrator has checked whom it involves. */
export function passes(row: ProcessRow, { status, definition, involves }: ProcessFilter): boolean {
  const [name, version] = definition.split("@");
  return (
    (status === "" || row.status === status || processState(row) === status) &&
    (definition === "" || (row.definition === name && (version === undefined || row.version === Number(version)))) &&
    (involves === "" || row.tasks === undefined || row.tasks.some((task) => task.involves.includes(involves)))
  );
}

/** The activities that a process is at, by name, those with an incident first; "" where that is not known. */
export function activityOf(row: ProcessRow): string {
  const open = (row.tasks ?? []).filter((task) => task.endedAt === null && !task.cancelled);
  return [...new Set([...(row.incidents ?? []), ...open].map(({ name, element }) => name || element))].join(", ");
}

/** The history, with processes that have ended meanwhile; bounded, the latest stay. */
export function remembered(history: readonly ProcessRow[], news: readonly ProcessRow[]): readonly ProcessRow[] {
  const known = new Map(history.map((row) => [row.id, row]));
  const fresh = news.filter((row) => row.endedAt !== null && known.get(row.id)?.endedAt !== row.endedAt);
  if (fresh.length === 0) return history;
  return together(fresh, history).ended.slice(0, MAX_ENDED);
}

/** The rows while somebody reads the list: in the same places, with the number of new ones. */
export function held(shown: Sections, now: Sections): { sections: Sections; waiting: number } {
  const current = new Map([...now.running, ...now.ended].map((row) => [row.id, row]));
  const keep = (rows: readonly ProcessRow[]) => rows.map((row) => current.get(row.id) ?? row);
  const known = new Set([...shown.running, ...shown.ended].map((row) => row.id));
  const moved = shown.running.filter((row) => current.get(row.id)?.endedAt != null).length;
  const fresh = [...current.keys()].filter((id) => !known.has(id)).length;
  return { sections: { running: keep(shown.running), ended: keep(shown.ended) }, waiting: fresh + moved };
}

/** Whether two lists show the same. */
export function sameSections(one: Sections, other: Sections): boolean {
  return sameRows(one.running, other.running) && sameRows(one.ended, other.ended);
}

/** Minimum length of a search for ids: shorter texts would match the invisible ids of many processes. */
const MIN_ID_PART = 8;

/** The processes whose name, title, definition, key or status has every word of the text, or whose id has it as it is. */
export function found<T extends ProcessRow>(rows: readonly T[], text: string, said: (state: ProcessState) => string): T[] {
  const words = wordsOf(text);
  const id = text.trim();
  return rows.filter(
    (row) =>
      has(words, [row.name, row.title, row.definition, row.key ?? "", said(processState(row))]) || (id.length >= MIN_ID_PART && row.id.includes(id)),
  );
}

export function foundDefinitions(rows: readonly DefinitionView[], text: string): DefinitionView[] {
  const words = wordsOf(text);
  return rows
    .filter((row) => has(words, [row.title, row.name, row.label ?? ""]))
    .sort((a, b) => a.title.localeCompare(b.title));
}

function wordsOf(text: string): string[] {
  return text.toLowerCase().split(/\s+/).filter((word) => word !== "");
}

function has(words: readonly string[], parts: readonly string[]): boolean {
  const text = parts.join("\n").toLowerCase();
  return words.every((word) => text.includes(word));
}

function sameRows(one: readonly ProcessRow[], other: readonly ProcessRow[]): boolean {
  return (
    one.length === other.length &&
    one.every((row, nth) => {
      const twin = other[nth];
      return (
        row.id === twin?.id && row.status === twin.status && row.endedAt === twin.endedAt &&
        row.reason === twin.reason && row.name === twin.name && row.title === twin.title && processState(row) === processState(twin)
      );
    })
  );
}

function compare(a: string, b: string, idA: string, idB: string): number {
  if (a === b) return idA < idB ? -1 : 1;
  return a < b ? -1 : 1;
}
