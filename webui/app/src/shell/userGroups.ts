/** The groups of the person at this screen, kept on this device: Tasks are offered to groups. */
import { useSyncExternalStore } from "react";

const STORAGE_KEY = "handover.groups";
const MAX_GROUPS = 50;
const listeners = new Set<() => void>();
let last: { text: string; groups: readonly string[] } = { text: "", groups: [] };

/** The same list as before while nothing has changed. */
export function userGroups(): readonly string[] {
  const text = localStorage.getItem(STORAGE_KEY) ?? "";
  if (text !== last.text) last = { text, groups: text.split("\n").filter((group) => group !== "") };
  return last.groups;
}

export function setUserGroups(groups: readonly string[]): void {
  const names = groups.map((group) => group.replace(/\s+/g, " ").trim().slice(0, 200)).filter((group) => group !== "");
  localStorage.setItem(STORAGE_KEY, [...new Set(names)].slice(0, MAX_GROUPS).join("\n"));
  for (const listener of listeners) listener();
}

export function useUserGroups(): readonly string[] {
  return useSyncExternalStore((listener) => {
    listeners.add(listener);
    return () => listeners.delete(listener);
  }, userGroups);
}
