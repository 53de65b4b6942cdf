/**
 * Marks: what is shown on the elements of a diagram. What should be there is compared with what is there, and
 * only the difference touches the drawing: a live process changes many times a second, its diagram hardly.
 */
import type { ElementCounts, ProcessView } from "~/api/generated/task-orchestrator";

/** A class on the element itself: it has a token, an incident or a fault, it failed, it is picked, a token may move to it. */
export type Look = "token" | "incident" | "failed" | "done" | "fault" | "picked" | "target" | Heat;

/** A colour of the heat map, from the least to the most. */
export type Heat = "heat1" | "heat2" | "heat3" | "heat4" | "heat5";

/** A small badge at the element. */
export interface Badge {
  kind: "token" | "incident" | "failed" | "count" | "duration" | "fault" | "warning" | "waiting";
  text: string;
  /** The full text, for tooltips and screen readers. */
  title: string;
}

export interface ElementMarks {
  looks: readonly Look[];
  badges: readonly Badge[];
}

/** By element. */
export type Marks = ReadonlyMap<string, ElementMarks>;

export const NO_MARKS: Marks = new Map();

/** The words that marks are written with, in the language of the page. */
export interface MarkWords {
  token: (count: number) => string;
  failed: (count: number) => string;
  incident: (count: number) => string;
  count: (count: number) => { text: string; title: string };
  duration: (lastMs: number | null, medianMs: number | null) => { text: string; title: string };
}

/**
 * The marks of a process: its tokens and incidents, what was done how often and how long it took, and what failed.
 * `drawnAt` returns the element of the drawing at which an element of a called process is shown.
 */
export function marksOfProcess(
  process: Pick<ProcessView, "waiting" | "elements"> & Partial<Pick<ProcessView, "incidents" | "tokens">>,
  words: MarkWords,
  drawnAt: (element: string) => string = (element) => element,
): Marks {
  const marks = new Map<string, ElementMarks>();
  const incidents = tally((process.incidents ?? []).map(({ element }) => drawnAt(element)));
  // `waiting` names each element once, with the events that are waited for. The token of a loop only holds those of its instances.
  const listed = (process.tokens ?? []).filter(({ state }) => state !== "loop").map(({ element }) => element);
  const places = [...listed, ...process.waiting.filter((element) => !listed.includes(element))];
  const tokens = tally(places.filter((element) => drawnAt(element) === element));
  for (const element of new Set([...tokens.keys(), ...incidents.keys(), ...Object.keys(process.elements)])) {
    const at = process.elements[element];
    const badges = at === undefined ? [] : badgesOf(at, words);
    const looks: Look[] = [];
    const held = tokens.get(element) ?? 0;
    const stopped = incidents.get(element) ?? 0;
    if (stopped > 0) {
      looks.push("incident");
      badges.unshift({ kind: "incident", text: stopped === 1 ? "" : String(stopped), title: words.incident(stopped) });
    } else if (held > 0) {
      looks.push("token");
      badges.unshift({ kind: "token", text: held === 1 ? "" : String(held), title: words.token(held) });
    } else if (at !== undefined && at.failed > 0 && at.completed === 0) {
      looks.push("failed");
    } else if (at !== undefined && at.completed > 0) {
      looks.push("done");
    }
    if (looks.length > 0 || badges.length > 0) marks.set(element, { looks, badges });
  }
  return marks;
}

/** The marks of a definition: the same counts over all its processes; no look, for there is no one state. */
export function marksOfStatistics(elements: Readonly<Record<string, ElementCounts>>, words: MarkWords): Marks {
  const marks = new Map<string, ElementMarks>();
  for (const [element, at] of Object.entries(elements)) {
    const badges = badgesOf(at, words);
    if (at.running > 0) badges.unshift({ kind: "token", text: String(at.running), title: words.token(at.running) });
    if (badges.length > 0) marks.set(element, { looks: [], badges });
  }
  return marks;
}

type Located = readonly { element: string | null; message: string }[];

/** The marks of faults, then of warnings: each element that has one, numbered as the lists beside the diagram are. */
export function marksOfFaults(faults: Located, warnings: Located = []): Marks {
  const marks = new Map<string, ElementMarks>();
  [...faults, ...warnings].forEach(({ element, message }, nth) => {
    if (element === null) return;
    const isFault = nth < faults.length;
    const at = marks.get(element) ?? { looks: [], badges: [] };
    const badge: Badge = { kind: isFault ? "fault" : "warning", text: String(nth + 1), title: message };
    marks.set(element, { looks: isFault ? ["fault"] : at.looks, badges: [...at.badges, badge] });
  });
  return marks;
}

/** The same marks with the reasons for which elements wait, by element. */
export function withWaiting(marks: Marks, reasons: ReadonlyMap<string, string>): Marks {
  const all = new Map(marks);
  for (const [element, title] of reasons) {
    const at = all.get(element);
    all.set(element, { looks: at?.looks ?? [], badges: [{ kind: "waiting", text: "", title }, ...(at?.badges ?? [])] });
  }
  return all;
}

/** The same marks with one element picked. */
export function withPicked(marks: Marks, element: string | null): Marks {
  if (element === null) return marks;
  const at = marks.get(element);
  return new Map(marks).set(element, { looks: [...(at?.looks ?? []), "picked"], badges: at?.badges ?? [] });
}

/** The same marks with the elements that a token can be moved to. */
export function withTargets(marks: Marks, targets: readonly string[]): Marks {
  const all = new Map(marks);
  for (const element of targets) {
    const at = all.get(element);
    all.set(element, { looks: [...(at?.looks ?? []), "target"], badges: at?.badges ?? [] });
  }
  return all;
}

export interface Difference {
  lose: { element: string; look: Look }[];
  gain: { element: string; look: Look }[];
  /** Elements whose badges are others now, with all that they have from now on. */
  badges: { element: string; badges: readonly Badge[] }[];
}

/** What has to change in the drawing so that it shows `wanted` instead of `shown`. */
export function difference(shown: Marks, wanted: Marks): Difference {
  const change: Difference = { lose: [], gain: [], badges: [] };
  for (const element of new Set([...shown.keys(), ...wanted.keys()])) {
    const was = shown.get(element);
    const is = wanted.get(element);
    if (was === is) continue;
    for (const look of was?.looks ?? []) if (is?.looks.includes(look) !== true) change.lose.push({ element, look });
    for (const look of is?.looks ?? []) if (was?.looks.includes(look) !== true) change.gain.push({ element, look });
    if (!sameBadges(was?.badges ?? [], is?.badges ?? [])) change.badges.push({ element, badges: is?.badges ?? [] });
  }
  return change;
}

function badgesOf(at: ElementCounts, words: MarkWords): Badge[] {
  const badges: Badge[] = [];
  if (at.failed > 0) badges.push({ kind: "failed", text: String(at.failed), title: words.failed(at.failed) });
  if (at.completed > 0) badges.push({ kind: "count", ...words.count(at.completed) });
  if (at.lastMs !== null || at.medianMs !== null) {
    badges.push({ kind: "duration", ...words.duration(at.lastMs, at.medianMs) });
  }
  return badges;
}

function sameBadges(one: readonly Badge[], other: readonly Badge[]): boolean {
  return (
    one.length === other.length &&
    one.every((badge, nth) => {
      const twin = other[nth];
      return badge.kind === twin?.kind && badge.text === twin.text && badge.title === twin.title;
    })
  );
}

function tally(elements: readonly string[]): Map<string, number> {
  const counts = new Map<string, number>();
  for (const element of elements) counts.set(element, (counts.get(element) ?? 0) + 1);
  return counts;
}
