/** Light, dark, or like the device. `public/theme.js` sets the chosen one before the first paint. */
import { useSyncExternalStore } from "react";

export type Theme = "system" | "light" | "dark";

const STORAGE_KEY = "handover.theme";
const device = matchMedia("(prefers-color-scheme: dark)");
const listeners = new Set<() => void>();

function storedTheme(): Theme {
  const stored = localStorage.getItem(STORAGE_KEY);
  return stored === "light" || stored === "dark" ? stored : "system";
}

function effectiveTheme(): "light" | "dark" {
  const chosen = storedTheme();
  return chosen === "system" ? (device.matches ? "dark" : "light") : chosen;
}

function apply(): void {
  document.documentElement.dataset["theme"] = effectiveTheme();
  for (const listener of listeners) listener();
}

export function storeTheme(theme: Theme): void {
  localStorage.setItem(STORAGE_KEY, theme);
  apply();
}

export function initTheme(): void {
  device.addEventListener("change", apply);
  apply();
}

export function useStoredTheme(): Theme {
  return useSyncExternalStore(subscribe, storedTheme);
}

/** The effective theme, for drawings without CSS: plots and the 3D view. */
export function useShownTheme(): "light" | "dark" {
  return useSyncExternalStore(subscribe, effectiveTheme);
}

function subscribe(listener: () => void): () => void {
  listeners.add(listener);
  return () => listeners.delete(listener);
}
