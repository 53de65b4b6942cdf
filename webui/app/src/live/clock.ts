/** A shared clock for all relative times: it ticks once a second while the page is visible. */
import { useSyncExternalStore } from "react";

const listeners = new Set<() => void>();
let now = Date.now();
let timer: ReturnType<typeof setInterval> | undefined;

function tick(): void {
  if (document.hidden) return;
  now = Date.now();
  for (const listener of listeners) listener();
}

function watch(listener: () => void): () => void {
  if (listeners.size === 0) {
    now = Date.now();
    timer = setInterval(tick, 1000);
  }
  listeners.add(listener);
  return () => {
    listeners.delete(listener);
    if (listeners.size === 0) clearInterval(timer);
  };
}

/** The time in ms, updated every `stepMs`, which is several seconds. */
export function useCoarseNow(stepMs: number): number {
  return useSyncExternalStore(watch, () => Math.floor(now / stepMs) * stepMs);
}

/** The time in ms, updated every second. */
export function useNow(): number {
  return useSyncExternalStore(watch, () => now);
}
