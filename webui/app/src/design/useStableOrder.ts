/** A list that keeps its order while somebody reads it: what is new is counted and waits. */
import { useState, type FocusEvent, type PointerEvent, type UIEvent } from "react";

/** So near to its top a list is still looked at from the top. */
const TOP_TOLERANCE_PX = 8;

export interface StableOrder<T> {
  rows: readonly T[];
  /** How many have come since. */
  waiting: number;
  /** Show them, in the order they belong in. */
  release: () => void;
}

/**
 * `rows` is the list as it belongs now, `all` looks up a row that is no longer part of it. While `isHeld`, rows
 * stay in their places with their newest values; another `signature` (a sorting, a filter) shows the list as it is.
 */
export function useStableOrder<T>(
  rows: readonly T[],
  keyOf: (row: T) => string,
  all: ReadonlyMap<string, T>,
  isHeld: boolean,
  signature: string,
): StableOrder<T> {
  const [kept, setKept] = useState<{ signature: string; keys: readonly string[] }>({ signature, keys: [] });
  const keys = rows.map(keyOf);
  const follows = !isHeld || kept.signature !== signature || kept.keys.length === 0;
  if (follows) {
    if (kept.signature !== signature || !same(kept.keys, keys)) setKept({ signature, keys });
    return { rows, waiting: 0, release: () => undefined };
  }
  const known = new Set(kept.keys);
  const shown = kept.keys.map((key) => all.get(key)).filter((row) => row !== undefined);
  return {
    rows: shown,
    waiting: keys.filter((key) => !known.has(key)).length,
    release: () => setKept({ signature, keys }),
  };
}

function same(one: readonly string[], other: readonly string[]): boolean {
  return one.length === other.length && one.every((key, nth) => key === other[nth]);
}

/** Whether somebody reads what the handlers are put on: the pointer or the focus is in it, or it is scrolled down. */
export function useIsReading() {
  const [reasons, setReasons] = useState<readonly string[]>([]);
  const set = (reason: string, on: boolean) =>
    setReasons((all) => (all.includes(reason) === on ? all : on ? [...all, reason] : all.filter((one) => one !== reason)));
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
