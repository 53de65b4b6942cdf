/** Errors about rights in words: which permission is missing, for what, and who can grant it. */
import { useEffect, useState } from "react";
import i18next from "i18next";
import { shortName } from "~/live/urn";
import { currentSession } from "./session";

const KEPT_MS = 60_000;
let loaded: { atMs: number; names: Promise<readonly string[]> } | null = null;
let known: readonly string[] = [];

/** Load the names of the users who can grant roles, at most once a minute; none if they cannot be loaded. */
export function loadAdmins(): Promise<readonly string[]> {
  if (!currentSession().hasAccounts) return Promise.resolve([]);
  if (loaded === null || Date.now() - loaded.atMs > KEPT_MS) {
    const names = Promise.all([fetch("/api/accounts/admins", { headers: { Accept: "application/json" } }), i18next.loadNamespaces(["rights", "roles"])]).then(
      async ([answer]) => {
        known = answer.ok ? ((await answer.json()) as string[]) : known;
        return known;
      },
      () => known,
    );
    loaded = { atMs: Date.now(), names };
  }
  return loaded.names;
}

export function useAdmins(): readonly string[] {
  const [names, setNames] = useState(known);
  useEffect(() => {
    let isShown = true;
    void loadAdmins().then((found) => {
      if (isShown) setNames(found);
    });
    return () => {
      isShown = false;
    };
  }, []);
  return names;
}

/** The text of a refusal that names a permission; null for other errors. Names the admins that were loaded. */
export function missingRight(problem: Readonly<Record<string, unknown>>): string | null {
  const { permission, resource, roles } = problem;
  if (typeof permission !== "string" || !i18next.exists(`rights:permission.${permission}`)) return null;
  const missing = i18next.t(`rights:permission.${permission}`);
  const what = typeof resource === "string" && resource !== "*" ? i18next.t("rights:missingFor", { permission: missing, resource: shortName(resource) }) : i18next.t("rights:missing", { permission: missing });
  const having = Array.isArray(roles) ? roles.map((role) => i18next.t(`roles:name.${String(role)}`, { defaultValue: String(role) })) : [];
  if (having.length === 0) return what;
  const who = known.length === 0 ? i18next.t("rights:anyAdmin", { roles: having.join(", ") }) : i18next.t("rights:admins", { roles: having.join(", "), names: known.join(", ") });
  return `${what} ${who}`;
}
