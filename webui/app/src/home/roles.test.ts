import { afterEach, expect, test, vi } from "vitest";
import roleTable from "~/session/roles.json";
import { loadSession } from "~/session/session";
import { columnsOf, homeRole, type SectionName } from "./roles";

const ALL = ["task-orchestrator", "gesture-controller", "trajectory-tool", "human-state", "whole-body-control", "assistive-devices"];

/** Sign in with the grants of some roles; without any, there are no accounts. */
async function signIn(...roles: string[]) {
  const permissions = Object.entries(roleTable.having).flatMap(([permission, having]) => (having.some((role) => roles.includes(role)) ? [permission] : []));
  const user = { subject: "u", name: "Anna", person: null, permissions, isLocal: false, isStation: false };
  const session = { hasAccounts: roles.length > 0, user: roles.length > 0 ? user : null, csrf: null, provider: null };
  vi.stubGlobal("fetch", () => Promise.resolve(new Response(JSON.stringify(session))));
  await loadSession();
}

afterEach(async () => {
  await signIn();
  vi.unstubAllGlobals();
});

const shown = (services = ALL, isNarrow = false, hasAccounts = true) => columnsOf(homeRole(), { services, hasAccounts }, isNarrow);

test.each([
  ["operator", "operator", "mine"],
  ["engineer", "engineer", "wrong"],
  ["researcher", "therapist", "care"],
  ["admin", "owner", "people"],
  ["viewer", "viewer", "running"],
])("%s sees the Home of the %s, first %s", async (role, home, first) => {
  await signIn(role);
  expect(homeRole()).toBe(home);
  expect(shown()[0]?.[0]).toBe(first);
});

test("nobody is shown what the role may not do, or what does not run", async () => {
  await signIn("operator");
  expect(shown().flat()).not.toContain("care");
  expect(shown().flat()).not.toContain("people");
  await signIn("researcher");
  expect(shown(["task-orchestrator"]).flat()).toEqual(["wrong", "running", "day"]);
  await signIn("engineer", "admin");
  expect(homeRole()).toBe("engineer");
  expect(shown().flat()).toContain("people");
});

test("without accounts everything that runs is there, and no list of users", () => {
  expect(homeRole()).toBe("engineer");
  const all: readonly SectionName[] = ["mine", "wrong", "running", "open", "day", "care", "exercises"];
  expect(new Set(shown(ALL, false, false).flat())).toEqual(new Set(all));
});

test("a narrow screen has one column with the same sections, what waits for the user first", async () => {
  for (const roles of [[], ["operator"], ["engineer", "admin"], ["researcher", "operator"]]) {
    await signIn(...roles);
    const columns = shown(ALL, true);
    expect(columns).toHaveLength(1);
    expect(columns[0]?.[0]).toBe("mine");
    expect(new Set(columns.flat())).toEqual(new Set(shown().flat()));
  }
});
