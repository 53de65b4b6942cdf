/** Who is signed in. Loaded before the page is rendered; signing in and out loads the page again. */
import { useSyncExternalStore } from "react";
import roles from "./roles.json";

export interface SignedInUser {
  subject: string;
  name: string;
  person: string | null;
  /** The permissions of at least one grant. */
  permissions: readonly string[];
  isLocal: boolean;
  /** Whether this screen is signed in as a station that people join. */
  isStation: boolean;
}

export interface Session {
  /** Whether people sign in; without accounts everybody on the machine is the owner. */
  hasAccounts: boolean;
  user: SignedInUser | null;
  csrf: string | null;
  /** The OpenID Connect provider where people may sign in, while nobody has. */
  provider: string | null;
}

const listeners = new Set<() => void>();
let session: Session = { hasAccounts: false, user: null, csrf: null, provider: null };

export function currentSession(): Session {
  return session;
}

/** Call `listener` when somebody else acts at this screen. */
export function onSession(listener: () => void): () => void {
  listeners.add(listener);
  return () => listeners.delete(listener);
}

export function useSession(): Session {
  return useSyncExternalStore(onSession, currentSession);
}

/** Load who is signed in; a server that does not answer changes nothing. */
export async function loadSession(): Promise<void> {
  try {
    const answer = await fetch("/api/session", { headers: { Accept: "application/json" } });
    if (!answer.ok) return;
    session = (await answer.json()) as Session;
    for (const listener of listeners) listener();
  } catch {
    // The connection state of the page shows that the server is away.
  }
}

/** Whether the page may be shown: somebody is signed in, or there are no accounts. */
export function isSignedIn(): boolean {
  return !session.hasAccounts || session.user !== null;
}

export type Permission = keyof typeof roles.having;

/** The roles that include a permission. */
export function rolesWith(permission: Permission): readonly string[] {
  return roles.having[permission];
}

export function mayDo(permission: Permission): boolean {
  return session.user === null || session.user.permissions.includes(permission);
}
