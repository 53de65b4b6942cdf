/** A list that keeps its order while somebody reads it. New rows are counted until they are shown. */
import { useState, type FocusEvent, type PointerEvent, type UIEvent } from "react";

/** A list scrolled by less counts as being at its top. */
const TOP_TOLERANCE_PX = 8;

export interface StableOrder<T> {
  rows: readonly T[];
  /** The number of new rows that are not shown yet. */
  waiting: number;
  /** Show all rows in their present order. */
  release: () => void;
}

/**
 * `rows` is the list in its present order; `all` also has rows that are no longer part of it. While `isHeld`, the
 * shown rows keep their places and show their newest values. New rows below all of them are appended. Another
 * `signature` (a sorting, a filter) shows the present order.
 */
export function useStableOrder<T>(
  rows: readonly T[],
  keyOf: (row: T) => string,
  all: ReadonlyMap<string, T>,
  isHeld: boolean,
  signature: string,
): StableOrder<T> {
  const [stable, setStable] = useState<{ signature: string; keys: readonly string[] }>({ signature, keys: [] });
  const keys = rows.map(keyOf);
  const follows = !isHeld || stable.signature !== signature || !stable.keys.some((key) => all.has(key));
  if (follows) {
    if (stable.signature !== signature || !isSame(stable.keys, keys)) setStable({ signature, keys });
    return { rows, waiting: 0, release: () => undefined };
  }
  const known = new Set(stable.keys);
  const below = keys.slice(keys.findLastIndex((key) => known.has(key)) + 1);
  const shown = below.length === keys.length ? stable.keys : [...stable.keys, ...below];
  if (shown.length > stable.keys.length) setStable({ signature, keys: shown });
  const isShown = new Set(shown);
  return {
    rows: shown.map((key) => all.get(key)).filter((row) => row !== undefined),
    waiting: keys.filter((key) => !isShown.has(key)).length,
    release: () => setStable({ signature, keys }),
  };
}

function isSame(first: readonly string[], second: readonly string[]): boolean {
  return first.length === second.length && first.every((key, index) => key === second[index]);
}

/** Whether somebody reads the element with the handlers: it has the pointer or the focus, or is scrolled down. */
export function useIsReading() {
  const [reasons, setReasons] = useState<readonly string[]>([]);
  const set = (reason: string, on: boolean) =>
    setReasons((all) => (all.includes(reason) === on ? all : on ? [...all, reason] : all.filter((other) => other !== reason)));
  const handlers = {
    onPointerEnter: (event: PointerEvent) => set("pointer", event.pointerType === "mouse"),
    onPointerLeave: () => set("pointer", false),
    onFocus: () => set("focus", true),
    onBlur: (event: FocusEvent) => {
      if (!event.currentTarget.contains(event.relatedTarget)) set("focus", false);
    },
    onScrollCapture: (event: UIEvent) => set("scroll", (event.target as HTMLElement).scrollTop > TOP_TOLERANCE_PX),
  };
  return { isReading: reasons.length > 0, handlers };
}
