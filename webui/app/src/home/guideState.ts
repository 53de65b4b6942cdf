/** Whether the guide of the first steps is put away on this device, or brought back. */
import { useSyncExternalStore } from "react";

const STORAGE_KEY = "handover.firstSteps";
type GuideState = "" | "dismissed" | "followed" | "wanted";
const listeners = new Set<() => void>();

function guideState(): GuideState {
  const stored = localStorage.getItem(STORAGE_KEY);
  return stored === "dismissed" || stored === "followed" || stored === "wanted" ? stored : "";
}

export function setGuideState(state: GuideState): void {
  localStorage.setItem(STORAGE_KEY, state);
  for (const listener of listeners) listener();
}

export function useGuideState(): GuideState {
  return useSyncExternalStore((listener) => {
    listeners.add(listener);
    return () => listeners.delete(listener);
  }, guideState);
}
