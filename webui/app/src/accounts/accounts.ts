/** The types and requests of accounts: users, grants, sessions, links, tokens. */
import { useQuery } from "@tanstack/react-query";
import type {
  AccountRequestView, DeletedUser, GrantBody, GrantView, IssuedToken, LinkView, NewInvitation, NewLink, NewToken, SessionView, TokenView, UserView,
} from "~/api/generated/accounts";
import { errorText, request, requestService } from "~/api/http";
import { queryClient } from "~/api/useServiceQuery";
import { shortName } from "~/live/urn";
import roles from "~/session/roles.json";

export type { AccountRequestView, DeletedUser, GrantBody, GrantView, IssuedToken, LinkView, NewLink, SessionView, TokenView, UserView };

export const SERVICE = "accounts";
/** The roles that the page offers. A performer is a program: `handover component add` makes its token and its file. */
export const ROLES: readonly string[] = roles.roles;
export const EVERYTHING = "*";
const USERS_A_PAGE = 500;

export interface Users {
  users: readonly UserView[] | null;
  failure: string | null;
  reload: () => void;
}

/** All users, loaded page by page. */
export function useUsers(isWanted = true): Users {
  const { data, error, failureReason, refetch } = useQuery({ queryKey: [SERVICE, "users"], queryFn: ({ signal }) => allUsers(signal), enabled: isWanted }, queryClient);
  const fault = error ?? failureReason;
  return { users: data ?? null, failure: fault === null ? null : errorText(fault), reload: () => void refetch() };
}

export async function allUsers(signal: AbortSignal): Promise<UserView[]> {
  const users: UserView[] = [];
  for (;;) {
    const after = users.at(-1)?.name ?? "";
    const page = await requestService<UserView[]>(SERVICE, `users?limit=${USERS_A_PAGE}&after=${encodeURIComponent(after)}`, { signal });
    users.push(...page);
    if (page.length < USERS_A_PAGE) return users;
  }
}

const ofUser = (subject: string) => `users/${encodeURIComponent(subject)}`;

export function setPerson(subject: string, person: string | null): Promise<unknown> {
  return requestService(SERVICE, ofUser(subject), { method: "PATCH", json: { person } });
}

export function deleteUser(subject: string): Promise<DeletedUser> {
  return requestService(SERVICE, ofUser(subject), { method: "DELETE" });
}

/** What the page server says about the data of a Person in one service; its `detail` says why they remain. */
export interface RemovedPart {
  service: string;
  outcome: "deleted" | "nothing" | "refused" | "unreachable";
  detail: string | null;
}

export interface RemovedPerson {
  parts: readonly RemovedPart[];
  /** What remains everywhere: `why`, with its code. */
  remains: readonly object[];
}

/** Delete a Person in every service: gestures, body signals, sessions and studies. */
export function removePerson(person: string): Promise<RemovedPerson> {
  return request(`persons/${encodeURIComponent(shortName(person))}`, { method: "DELETE" });
}

export function makePasswordLink(subject: string): Promise<NewLink> {
  return requestService(SERVICE, `${ofUser(subject)}/password-link`, { method: "POST" });
}

export function endSession(path: string, session: string): Promise<unknown> {
  return requestService(SERVICE, `${path}/${encodeURIComponent(session)}`, { method: "DELETE" });
}

export function endSessions(path: string): Promise<unknown> {
  return requestService(SERVICE, path, { method: "DELETE" });
}

/** Add grants one after the other: the first refused one ends it with its error. */
export async function addGrants(subject: string, grants: readonly GrantBody[]): Promise<void> {
  for (const grant of grants) await requestService(SERVICE, "grants", { method: "POST", json: { subject, ...grant } });
}

export function removeGrant(grant: string): Promise<unknown> {
  return requestService(SERVICE, `grants/${encodeURIComponent(grant)}`, { method: "DELETE" });
}

export function invite(json: NewInvitation): Promise<NewLink> {
  return requestService(SERVICE, "invitations", { method: "POST", json });
}

export function withdraw(link: string): Promise<unknown> {
  return requestService(SERVICE, `invitations/${encodeURIComponent(link)}`, { method: "DELETE" });
}

export function closeRequest(request: string): Promise<unknown> {
  return requestService(SERVICE, `account-requests/${encodeURIComponent(request)}`, { method: "DELETE" });
}

export function issueToken(json: NewToken): Promise<IssuedToken> {
  return requestService(SERVICE, "tokens", { method: "POST", json });
}

export function revokeToken(subject: string): Promise<unknown> {
  return requestService(SERVICE, `tokens/${encodeURIComponent(subject)}`, { method: "DELETE" });
}

/** The address of a one-time link; its secret stands behind the #, which browsers do not send. */
export function addressOf(link: NewLink): string {
  return `${location.origin}/join#${link.link}`;
}

/** The grants by role, in the order of the roles and then others, each with its resources. */
export function byRole<T extends { role: string; resource: string }>(grants: readonly T[]): { role: string; grants: T[] }[] {
  const order = (role: string) => (ROLES.includes(role) ? ROLES.indexOf(role) : ROLES.length);
  const roles = [...new Set(grants.map(({ role }) => role))].sort((a, b) => order(a) - order(b));
  return roles.map((role) => ({ role, grants: grants.filter((grant) => grant.role === role) }));
}

/** The name of a resource for people: a pattern as it is, an entity id by its last part. */
export function resourceName(resource: string): string {
  return resource.includes("*") ? resource : shortName(resource);
}

/** "Firefox, Windows" of the User-Agent of a browser; other programs by their own name. */
export function deviceName(userAgent: string): string {
  const browser = [
    ["Edg/", "Edge"], ["OPR/", "Opera"], ["Firefox/", "Firefox"], ["Chrome/", "Chrome"], ["Safari/", "Safari"],
  ].find(([mark]) => userAgent.includes(mark ?? ""))?.[1];
  const system = [
    ["Android", "Android"], ["iPhone", "iPhone"], ["iPad", "iPad"], ["Windows", "Windows"], ["Mac OS", "macOS"], ["Linux", "Linux"],
  ].find(([mark]) => userAgent.includes(mark ?? ""))?.[1];
  if (browser === undefined) return userAgent.split(/[\s/]/)[0] ?? "";
  return system === undefined ? browser : `${browser}, ${system}`;
}
