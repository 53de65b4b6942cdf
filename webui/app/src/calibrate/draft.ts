/** A draft of thresholds, which applies once it is saved. */
import { fingers } from "~/hand/geometry";
import type { Finger, GloveView } from "~/live/messages";

export type Thresholds = GloveView["thresholds"];
export type Bound = "upper" | "lower";
export const bounds: readonly Bound[] = ["upper", "lower"];

/** The step sizes, in raw units of the glove. */
export const steps = ["5", "25", "100"] as const;
export type Step = (typeof steps)[number];

/** The thresholds after moving one; the lower of a finger stays below its upper. */
export function moved(thresholds: Thresholds, finger: Finger, bound: Bound, to: number): Thresholds {
  const { upper, lower } = thresholds[finger];
  const whole = Math.round(to);
  const after = bound === "upper" ? { upper: Math.max(whole, lower), lower } : { upper, lower: Math.min(whole, upper) };
  return { ...thresholds, [finger]: { ...thresholds[finger], ...after } };
}

/** The changed thresholds as a request body; null without changes. */
export function changesOf(saved: Thresholds, draft: Thresholds): Partial<Thresholds> | null {
  const changed = fingers.filter((finger) => bounds.some((bound) => saved[finger][bound] !== draft[finger][bound]));
  return changed.length === 0 ? null : Object.fromEntries(changed.map((finger) => [finger, draft[finger]]));
}

/** The state of a finger: 0 straight, 1 between, 2 bent. */
export function stateUnder({ upper, lower, inverted = false }: Thresholds[Finger], bend: number): "0" | "1" | "2" {
  if (bend > upper) return inverted ? "2" : "0";
  if (bend < lower) return inverted ? "0" : "2";
  return "1";
}

/** The upper end of the gauges: a little above the highest threshold, independent of the signal. */
export function topOf(thresholds: Thresholds): number {
  return Math.ceil((Math.max(...fingers.map((finger) => thresholds[finger].upper)) * 1.35) / 100) * 100;
}
