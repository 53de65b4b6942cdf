/**
 * Marks: what is shown on the elements of a diagram. What should be there is compared with what is there, and
 * only the difference touches the drawing: a live process changes many times a second, its diagram hardly.
 */
import type { ElementCount, ProcessView } from "~/live/messages";

/** A class on the element itself: it holds a token, it failed, it has a fault, it is picked. */
export type Look = "token" | "failed" | "done" | "fault" | "picked";

/** A small badge at the element. */
export interface Badge {
  kind: "token" | "failed" | "count" | "duration" | "fault";
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
  count: (count: number) => { text: string; title: string };
  duration: (lastMs: number | null, medianMs: number | null) => { text: string; title: string };
}

/** The marks of a process: its tokens, what was done how often and how long it took, and what failed. */
export function marksOfProcess(process: Pick<ProcessView, "waiting" | "elements">, words: MarkWords): Marks {
  const marks = new Map<string, ElementMarks>();
  const tokens = tally(process.waiting);
  for (const element of new Set([...tokens.keys(), ...Object.keys(process.elements)])) {
    const at = process.elements[element];
    const badges = at === undefined ? [] : badgesOf(at, words);
    const looks: Look[] = [];
    const held = tokens.get(element) ?? 0;
    if (held > 0) {
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
export function marksOfStatistics(elements: Readonly<Record<string, ElementCount>>, words: MarkWords): Marks {
  const marks = new Map<string, ElementMarks>();
  for (const [element, at] of Object.entries(elements)) {
    const badges = badgesOf(at, words);
    if (at.running > 0) badges.unshift({ kind: "token", text: String(at.running), title: words.token(at.running) });
    if (badges.length > 0) marks.set(element, { looks: [], badges });
  }
  return marks;
}

/** The marks of faults: each element that has one, numbered as the list beside the diagram is. */
export function marksOfFaults(faults: readonly { element: string | null; message: string }[]): Marks {
  const marks = new Map<string, ElementMarks>();
  faults.forEach(({ element, message }, nth) => {
    if (element === null) return;
    const badge: Badge = { kind: "fault", text: String(nth + 1), title: message };
    const badges = [...(marks.get(element)?.badges ?? []), badge];
    marks.set(element, { looks: ["fault"], badges });
  });
  return marks;
}

/** The same marks with one element picked. */
export function withPicked(marks: Marks, element: string | null): Marks {
  if (element === null) return marks;
  const at = marks.get(element);
  return new Map(marks).set(element, { looks: [...(at?.looks ?? []), "picked"], badges: at?.badges ?? [] });
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

function badgesOf(at: ElementCount, words: MarkWords): Badge[] {
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
