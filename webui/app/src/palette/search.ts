/** What the palette lists for a query: pages, objects, and the acts that the user may do on them. */
import { mayDo } from "~/session/session";
import { allActs, isObjectAct, type Act, type ActContext, type ObjectAct, type PlainAct } from "./acts";
import { entryOf, KINDS, permissionOf, type Entry, type Kind } from "./entries";
import { ranked, wordNumbers, type Candidate } from "./ranking";
import type { Recent } from "./recents";
import { typedWords, wordsOf } from "./words";

export interface Row extends Candidate {
  kind: Kind;
  detail: string;
  icon: Act["icon"];
  /** What it opens; undefined for an act without an address. */
  address: string | undefined;
  act?: Act;
  /** The object of an act, or the entry itself. */
  subject?: Entry;
}

export interface Searched {
  pages: readonly Entry[];
  objects: readonly Entry[];
  entry: (id: string) => Entry | undefined;
  recent: readonly Recent[];
  around: ActContext;
}

export const MAX_ROWS = 50;
const MAX_RECENT_ROWS = 8;
/** So many objects are listed for each act. */
const MAX_SUBJECTS = 12;
/** An act on objects is listed from this number of its letters on. */
const MIN_VERB = 2;
/** An act on an object stands behind the object. */
const OBJECT_ACT_WEIGHT = 1;

/** The rows for a query, the best first; at most `MAX_ROWS`. */
export function rowsFor(query: string, searched: Searched): Row[] {
  const recent = searched.recent.map(({ id }) => id);
  const acts = offeredActs(searched.around);
  const candidates: (Row | Entry)[] = [
    ...searched.pages,
    ...acts.plain.map(rowOfAct),
    ...acts.ofObjects.flatMap((act) => rowsOfObjectAct(act, query, searched, recent)),
    ...searched.objects,
  ];
  return ranked(candidates, query, recent, MAX_ROWS).map(asRow);
}

/** What is listed before anything is typed: what was used lately, then pages, then acts and settings. */
export function initialRows(searched: Searched): { recent: Row[]; acts: Row[]; pages: Row[] } {
  const acts = offeredActs(searched.around).plain.map(rowOfAct);
  const pages = searched.pages.map(asRow);
  const all = new Map([...acts, ...pages].map((row) => [row.id, row]));
  const recent = searched.recent
    .flatMap(({ id, kind, name, address }) => {
      const current = searched.entry(id);
      const row = all.get(id) ?? (current === undefined ? undefined : asRow(current));
      if (row !== undefined) return [row];
      // It may be archived; what the table of acts or pages does not have is not offered any more.
      const isGone = !(kind in KINDS) || kind === "act" || kind === "setting" || kind === "page" || !maySee(kind);
      return isGone ? [] : [asRow(entryOf({ id, kind, name, address, detail: "", more: [] }))];
    })
    .slice(0, MAX_RECENT_ROWS);
  const used = new Set(recent.map(({ id }) => id));
  return { recent, acts: acts.filter(({ id }) => !used.has(id)), pages: pages.filter(({ id }) => !used.has(id)) };
}

/** Rows that are shown stay where they are; those that arrive for the same query follow. */
export function kept(shown: readonly Row[], now: readonly Row[]): readonly Row[] {
  const current = new Map(now.map((row) => [row.id, row]));
  const ids = new Set(shown.map(({ id }) => id));
  return [...shown.map((row) => current.get(row.id) ?? row), ...now.filter(({ id }) => !ids.has(id))].slice(0, Math.max(MAX_ROWS, shown.length));
}

export function asRow(candidate: Row | Entry): Row {
  return "icon" in candidate ? candidate : { ...candidate, icon: KINDS[candidate.kind].icon, subject: candidate };
}

export function maySee(kind: Kind): boolean {
  const permission = permissionOf(kind);
  return permission === undefined || mayDo(permission);
}

function offeredActs(around: ActContext): { plain: PlainAct[]; ofObjects: ObjectAct[] } {
  const allowed = allActs().filter(({ permission }) => permission === undefined || mayDo(permission));
  return {
    plain: allowed.filter((act): act is PlainAct => !isObjectAct(act) && (act.isOffered?.(around) ?? true)),
    ofObjects: allowed.filter(isObjectAct),
  };
}

function rowOfAct(act: PlainAct): Row {
  const name = act.text();
  const kind = act.isSetting === true ? "setting" : "act";
  return { id: `act/${act.id}`, kind, name, words: wordNumbers(name), moreWords: wordNumbers(act.more?.() ?? ""), weight: KINDS[kind].weight, detail: "", icon: act.icon, address: act.address, act };
}

/** An act on those objects that the other words name, if one of the words names the act. */
function rowsOfObjectAct(act: ObjectAct, query: string, { objects, entry }: Searched, recent: readonly string[]): Row[] {
  const verbs = [...wordsOf(act.text("")), ...wordsOf(act.more?.() ?? "")];
  const typed = typedWords(query);
  const others = typed.filter((word) => word.length < MIN_VERB || !verbs.some((verb) => verb.startsWith(word)));
  if (others.length === typed.length) return [];
  const subjects = objects.filter(({ kind, value }) => kind === act.of && value !== undefined && (act.isOffered?.(value as never, entry) ?? true));
  const named = others.length > 0 ? ranked(subjects, others.join(" "), recent, MAX_SUBJECTS) : [...subjects].sort((a, b) => placeIn(recent, a.id) - placeIn(recent, b.id));
  return named.slice(0, MAX_SUBJECTS).map((subject) => {
    const name = act.text(subject.name);
    return {
      id: `act/${act.id}/${subject.id}`,
      kind: "act",
      name,
      words: wordNumbers(name),
      moreWords: [...wordNumbers(act.more?.() ?? ""), ...subject.moreWords],
      weight: OBJECT_ACT_WEIGHT,
      detail: subject.detail,
      icon: act.icon,
      address: act.address?.(subject.value as never),
      act,
      subject,
    };
  });
}

function placeIn(recent: readonly string[], id: string): number {
  const place = recent.indexOf(id);
  return place < 0 ? recent.length : place;
}
