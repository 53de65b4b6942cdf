/** Heat: how an element of the drawing is coloured by its durations or counts, and the badges on it. */
import type { CauseView, ElementTimes } from "~/api/generated/task-orchestrator";
import type { Badge, ElementMarks, Heat, Marks } from "~/processes/diagram/marks";

export const MEASURES = ["meanMs", "medianMs", "p90Ms", "waitingMs", "completed", "failed"] as const;
export type Measure = (typeof MEASURES)[number];

export const HEATS: readonly Heat[] = ["heat1", "heat2", "heat3", "heat4", "heat5"];

export function isDuration(measure: Measure): boolean {
  return measure.endsWith("Ms");
}

/** The value of an element; null without one. No failures and no completed Tasks are no value. */
export function valueOf(element: ElementTimes, measure: Measure): number | null {
  const value = element[measure];
  return value === 0 && !isDuration(measure) ? null : value;
}

export interface Scale {
  least: number;
  most: number;
}

/** The range of the values; null without values. */
export function scaleOf(elements: readonly ElementTimes[], measure: Measure): Scale | null {
  const values = elements.map((each) => valueOf(each, measure)).filter((value) => value !== null);
  return values.length === 0 ? null : { least: Math.min(...values), most: Math.max(...values) };
}

/** One of five heats by equal parts of the scale; a single value is the hottest. */
export function heatOf(value: number, { least, most }: Scale): Heat {
  const share = most === least ? 1 : (value - least) / (most - least);
  return HEATS[Math.min(HEATS.length - 1, Math.floor(share * HEATS.length))] ?? "heat5";
}

export interface HeatWords {
  value: (value: number) => string;
  measured: (value: string) => string;
  open: (element: ElementTimes) => string;
  incidents: (count: number) => string;
}

/**
 * The marks of the drawing: its heat, the value, open Tasks and incidents. Elements of a called process are shown at
 * the call activity, which is the part of their path before the dot.
 */
export function heatMarks(elements: readonly ElementTimes[], causes: readonly CauseView[], measure: Measure, words: HeatWords): Marks {
  const scale = scaleOf(elements, measure);
  const stopped = new Map<string, number>();
  for (const { element, count } of causes) {
    const drawn = element.split(".")[0] ?? element;
    stopped.set(drawn, (stopped.get(drawn) ?? 0) + count);
  }
  const marks = new Map<string, ElementMarks>();
  for (const element of elements) {
    const value = valueOf(element, measure);
    const badges: Badge[] = [];
    const open = element.waiting + element.working + element.paused;
    if (open > 0) badges.push({ kind: "token", text: String(open), title: words.open(element) });
    if (value !== null) badges.push({ kind: "duration", text: words.value(value), title: words.measured(words.value(value)) });
    marks.set(element.element, { looks: value === null || scale === null ? [] : [heatOf(value, scale)], badges });
  }
  for (const [element, count] of stopped) {
    const known = marks.get(element) ?? { looks: [], badges: [] };
    const badge: Badge = { kind: "incident", text: String(count), title: words.incidents(count) };
    marks.set(element, { looks: known.looks, badges: [badge, ...known.badges] });
  }
  return marks;
}
