/** Kiosk: the Work page of this device hides the navigation. Stored on this device. */
import { useSyncExternalStore } from "react";

const STORAGE_KEY = "handover.kiosk";
const listeners = new Set<() => void>();

export function isKiosk(): boolean {
  return localStorage.getItem(STORAGE_KEY) === "true";
}

export function setKiosk(isOn: boolean): void {
  if (isOn) localStorage.setItem(STORAGE_KEY, "true");
  else localStorage.removeItem(STORAGE_KEY);
  for (const listener of listeners) listener();
}

export function useKiosk(): boolean {
  return useSyncExternalStore(subscribe, isKiosk);
}

function subscribe(listener: () => void): () => void {
  listeners.add(listener);
  addEventListener("storage", listener);
  return () => {
    listeners.delete(listener);
    removeEventListener("storage", listener);
  };
}
