/** What the user has opened or done lately, the last first; stored on this device for each user. */
import { currentSession } from "~/session/session";
import type { Entry } from "./entries";

export type Recent = Pick<Entry, "id" | "kind" | "name" | "address">;

const STORAGE_KEY = "handover.recent";
const MAX_RECENT = 20;
/** A screen that many people share keeps those of the last ones. */
const MAX_USERS = 20;
const NOBODY = "";

type Stored = Record<string, Recent[]>;

function stored(): Stored {
  try {
    const value = JSON.parse(localStorage.getItem(STORAGE_KEY) ?? "{}") as unknown;
    return typeof value === "object" && value !== null ? (value as Stored) : {};
  } catch {
    return {};
  }
}

function subject(): string {
  return currentSession().user?.subject ?? NOBODY;
}

export function recents(): readonly Recent[] {
  const own = stored()[subject()];
  return Array.isArray(own) ? own : [];
}

/** Remember an entry. Names of people are not stored at a station, where others may read them. */
export function remember({ id, kind, name, address }: Recent): void {
  const isOfPerson = kind === "person" || kind === "user" || kind === "patient";
  if (isOfPerson && currentSession().user?.isStation === true) return;
  const own = [{ id, kind, name, address }, ...recents().filter((recent) => recent.id !== id)].slice(0, MAX_RECENT);
  const kept = Object.entries(stored()).filter(([other]) => other !== subject()).slice(0, MAX_USERS - 1);
  localStorage.setItem(STORAGE_KEY, JSON.stringify({ [subject()]: own, ...Object.fromEntries(kept) }));
}
