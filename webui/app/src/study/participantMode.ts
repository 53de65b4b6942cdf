/**
 * The participant's mode of this browser: while a participant has the screen, it shows the study and the Work
 * page of their glove and nothing else. Kept on this device, so that loading the page again changes nothing.
 * The code keeps a participant from leaving by chance; it is no protection against an attacker.
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

/** Return the code that gives the screen back to who leads the study; four digits, made up once a device. */
export function leaderCode(): string {
  const kept = localStorage.getItem(KEPT_CODE);
  if (kept !== null && kept !== "") return kept;
  const [number = 0] = crypto.getRandomValues(new Uint32Array(1));
  const code = String(1000 + (number % 9000));
  localStorage.setItem(KEPT_CODE, code);
  return code;
}
