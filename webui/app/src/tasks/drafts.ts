/** What a person has typed and not sent yet, kept on this device: it survives a reload and a lost connection. */
import type { Outcome } from "~/live/messages";
import type { Draft } from "./form";

export interface ResultDraft {
  entries: Draft;
  outcome: Outcome;
  note: string;
}

export interface CommentDraft {
  text: string;
  id: string;
}

const MAX_DRAFTS = 50;

/** Drafts by subject, the oldest first. */
class Drafts<T> {
  readonly #storageKey: string;

  constructor(storageKey: string) {
    this.#storageKey = storageKey;
  }

  /** The draft for a subject; null if there is none. */
  of(subject: string): T | null {
    return this.#stored().find(([known]) => known === subject)?.[1] ?? null;
  }

  /** Keep a draft; null forgets it. */
  keep(subject: string, draft: T | null): void {
    const others = this.#stored().filter(([known]) => known !== subject);
    if (draft !== null) others.push([subject, draft]);
    try {
      localStorage.setItem(this.#storageKey, JSON.stringify(others.slice(-MAX_DRAFTS)));
    } catch {
      // The storage is full: the entries stay on the page.
    }
  }

  #stored(): [string, T][] {
    try {
      const read = JSON.parse(localStorage.getItem(this.#storageKey) ?? "[]") as unknown;
      return Array.isArray(read) ? (read as [string, T][]) : [];
    } catch {
      return [];
    }
  }
}

const results = new Drafts<ResultDraft>("handover.drafts");
export const commentDrafts = new Drafts<CommentDraft>("handover.comments");

/** The draft of a person for the result of a Task; null if there is none. */
export function draftOf(task: string, by: string): ResultDraft | null {
  return results.of(`${by}\n${task}`);
}

/** Keep the draft of a person for the result of a Task; null forgets it. */
export function keepDraft(task: string, by: string, draft: ResultDraft | null): void {
  results.keep(`${by}\n${task}`, draft);
}
