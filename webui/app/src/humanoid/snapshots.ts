/** Snapshots for panels, which a person reads and which change less often than the picture. */
import type { Tone } from "~/design/StatusBadge";

interface Store<T> {
  subscribe: (listener: () => void) => () => void;
  snapshot: () => T;
}

/** A store whose snapshot changes at most every `everyMs`; the newest one always follows. */
export function throttled<T>(store: Store<T>, everyMs: number): Store<T> {
  let shown = store.snapshot();
  let changedMs = -Infinity;
  let waiting: ReturnType<typeof setTimeout> | undefined;
  const listeners = new Set<() => void>();
  const change = () => {
    waiting = undefined;
    changedMs = performance.now();
    shown = store.snapshot();
    for (const listener of listeners) listener();
  };
  const notice = () => {
    const restMs = changedMs + everyMs - performance.now();
    if (restMs <= 0) change();
    else waiting ??= setTimeout(change, restMs);
  };
  let end: (() => void) | null = null;
  return {
    subscribe: (listener) => {
      listeners.add(listener);
      end ??= store.subscribe(notice);
      return () => {
        listeners.delete(listener);
        if (listeners.size > 0) return;
        clearTimeout(waiting);
        waiting = undefined;
        end?.();
        end = null;
      };
    },
    snapshot: () => shown,
  };
}

export function modeTone(mode: string): Tone {
  if (mode === "fault" || mode === "down" || mode === "holding") return "stop";
  if (mode === "stopped") return "attention";
  return mode === "following" || mode === "standing" ? "ok" : "neutral";
}
