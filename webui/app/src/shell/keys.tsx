/**
 * Keys: a page declares its own (`useKeys`), the shell handles them, and the list of keys shows them.
 *
 * No plain key acts. A key of navigation is `g`, then a letter; it can be switched off (WCAG 2.1.4). What confirms, starts,
 * moves or deletes is a button that has the focus and is pressed.
 */
import { useEffect, useRef, useSyncExternalStore } from "react";
import { keyPresses } from "./scans";

export interface Key {
  /** A letter, which is typed after `g`, or a key without a character, such as `Escape`. */
  key: string;
  /** Where the key leads, in the language of the page. */
  does: string;
  act: () => void;
}

/** The stroke before the letter. */
export const LEAD = "g";
const LEAD_TIMEOUT_MS = 3000;
const STORAGE_KEY = "handover.keys";

let pageKeys: readonly Key[] = [];
const listeners = new Set<() => void>();

function changed(): void {
  for (const listener of listeners) listener();
}

function subscribe(listener: () => void): () => void {
  listeners.add(listener);
  return () => listeners.delete(listener);
}

function set(keys: readonly Key[]): void {
  pageKeys = keys;
  changed();
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
  return useSyncExternalStore(subscribe, () => pageKeys);
}

/** Whether keys of navigation are switched on. */
export function areKeysOn(): boolean {
  return localStorage.getItem(STORAGE_KEY) !== "off";
}

export function useKeysOn(): boolean {
  return useSyncExternalStore(subscribe, areKeysOn);
}

export function setKeysOn(on: boolean): void {
  localStorage.setItem(STORAGE_KEY, on ? "on" : "off");
  changed();
}

/** Whether a key needs the stroke before it: it has a character. */
export function hasLead({ key }: { key: string }): boolean {
  return key.length === 1;
}

/** `g` was the key press of this number, at this time; kept while the keys of a page are exchanged. */
let lead: { press: number; at: number } | null = null;

/** Handle the keys until the returned function is called. */
export function listenForKeys(keys: readonly Pick<Key, "key" | "act">[]): () => void {
  const listen = (event: KeyboardEvent) => {
    const before = lead;
    lead = null;
    if (isForOtherTarget(event)) return;
    const name = event.key.length === 1 ? event.key.toLowerCase() : event.key;
    const isLed = before !== null && before.press === keyPresses() - 1 && event.timeStamp - before.at < LEAD_TIMEOUT_MS;
    const match = keys.find((key) => key.key === name && (!hasLead(key) || (isLed && areKeysOn())));
    if (match !== undefined) {
      event.preventDefault();
      match.act();
    } else if (name === LEAD && areKeysOn()) lead = { press: keyPresses(), at: event.timeStamp };
  };
  document.addEventListener("keydown", listen);
  return () => document.removeEventListener("keydown", listen);
}

const TAKES_KEYS =
  "input, textarea, select, [contenteditable], [data-takes-keys], [role=alertdialog], [role=application], [role=combobox], [role=dialog], [role=listbox], [role=menu], [role=slider], [role=spinbutton], [role=tree]";

/** Whether a dialog or the control of a robot has all keys. */
export function isInputTaken(): boolean {
  return document.querySelector("[data-takes-keyboard], [role=dialog], [role=alertdialog]") !== null;
}

/** Whether a key press is meant for a field, a widget, an open dialog or the control of a robot, or is a key held down. */
function isForOtherTarget(event: KeyboardEvent): boolean {
  if (event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey || event.repeat) return true;
  if (isInputTaken()) return true;
  const target = event.target as Element | null;
  return target?.closest(TAKES_KEYS) != null;
}
