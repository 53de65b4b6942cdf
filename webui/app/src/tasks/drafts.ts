/** What a person has typed and not sent yet, kept on this device: it survives a reload and a lost connection. */
import type { Outcome } from "~/live/messages";
import type { Draft } from "./form";

export interface ResultDraft {
  entries: Draft;
  outcome: Outcome;
  note: string;
}

const STORAGE_KEY = "handover.drafts";
const MAX_DRAFTS = 50;

/** The oldest first. */
type Stored = [string, ResultDraft][];

function stored(): Stored {
  try {
    const read = JSON.parse(localStorage.getItem(STORAGE_KEY) ?? "[]") as unknown;
    return Array.isArray(read) ? (read as Stored) : [];
  } catch {
    return [];
  }
}

/** The draft of a person for a Task; null if there is none. */
export function draftOf(task: string, by: string): ResultDraft | null {
  const key = keyOf(task, by);
  return stored().find(([known]) => known === key)?.[1] ?? null;
}

/** Keep a draft; null forgets it. */
export function keepDraft(task: string, by: string, draft: ResultDraft | null): void {
  const key = keyOf(task, by);
  const others = stored().filter(([known]) => known !== key);
  if (draft !== null) others.push([key, draft]);
  try {
    localStorage.setItem(STORAGE_KEY, JSON.stringify(others.slice(-MAX_DRAFTS)));
  } catch {
    // The storage is full: the entries stay on the page.
  }
}

function keyOf(task: string, by: string): string {
  return `${by}\n${task}`;
}
