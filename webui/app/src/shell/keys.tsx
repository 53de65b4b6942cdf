/** Keyboard shortcuts: a page declares its own (`useKeys`), the shell handles them, and `?` lists them. */
import { useEffect, useRef, useSyncExternalStore } from "react";

export interface Key {
  /** A `KeyboardEvent.key`, in lower case. */
  key: string;
  /** The action, in the language of the page. */
  does: string;
  act: () => void;
}

let pageKeys: readonly Key[] = [];
const listeners = new Set<() => void>();

function set(keys: readonly Key[]): void {
  pageKeys = keys;
  for (const listener of listeners) listener();
}

/** Handle keys while the page is mounted. */
export function useKeys(keys: readonly Key[]): void {
  const signature = keys.map((key) => `${key.key} ${key.does}`).join("\n");
  const newest = useRef(keys);
  useEffect(() => {
    newest.current = keys;
  });
  useEffect(() => {
    set(newest.current.map((key, index) => ({ ...key, act: () => newest.current[index]?.act() })));
    return () => set([]);
  }, [signature]);
}

export function usePageKeys(): readonly Key[] {
  return useSyncExternalStore((listener) => {
    listeners.add(listener);
    return () => listeners.delete(listener);
  }, () => pageKeys);
}

/** Whether a key press is meant for a field, a menu or an open dialog rather than for the page, or is a key held down. */
export function isForOtherTarget(event: KeyboardEvent): boolean {
  if (event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey || event.repeat) return true;
  const target = event.target as Element | null;
  return target?.closest("input, textarea, select, [contenteditable], [role=dialog], [role=listbox], [role=menu]") != null;
}
