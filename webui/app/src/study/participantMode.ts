/**
 * The participant's mode of this browser: while a participant has the screen, it shows the study and the Work
* page of their glove and nothing else. Stored on this device, so that reloading the page does not end it.
* The code prevents leaving by accident; it is no protection against an attacker.
 */
import { useSyncExternalStore } from "react";
import type { Language } from "./study";

export interface ParticipantMode {
  session: string;
  glove: string | null;
  language: Language;
  pseudonym: string;
  paused: boolean;
}

const STORAGE_KEY = "handover.participant";
const KEPT_CODE = "handover.participant.code";
const listeners = new Set<() => void>();

function read(): ParticipantMode | null {
  try {
    return JSON.parse(localStorage.getItem(STORAGE_KEY) ?? "null") as ParticipantMode | null;
  } catch {
    return null;
  }
}

let mode: ParticipantMode | null = read();

function set(next: ParticipantMode | null): void {
  mode = next;
  if (next === null) localStorage.removeItem(STORAGE_KEY);
  else localStorage.setItem(STORAGE_KEY, JSON.stringify(next));
  for (const listener of listeners) listener();
}

export function useParticipantMode(): ParticipantMode | null {
  return useSyncExternalStore((listener) => {
    listeners.add(listener);
    return () => listeners.delete(listener);
  }, () => mode);
}

export function enterParticipantMode({ session, glove, language, pseudonym }: Omit<ParticipantMode, "paused">): void {
  if (mode?.session !== session) set({ session, glove, language, pseudonym, paused: false });
}

export function setPaused(paused: boolean): void {
  if (mode !== null) set({ ...mode, paused });
}

export function leaveParticipantMode(): void {
  set(null);
}

/** Return the code that returns the screen to the study leader: four digits, generated once per device. */
export function leaderCode(): string {
  const stored = localStorage.getItem(KEPT_CODE);
  if (stored !== null && stored !== "") return stored;
  const [number = 0] = crypto.getRandomValues(new Uint32Array(1));
  const code = String(1000 + (number % 9000));
  localStorage.setItem(KEPT_CODE, code);
  return code;
}
