/** The pages as entries, and the views within them that have an address of their own. */
import i18next from "i18next";
import { ALERTS_PAGE, type Place } from "~/places/places";
import { currentSession, mayDo, type Permission } from "~/session/session";
import { addresses } from "~/places/addresses";
import { entryOf, type Entry } from "./entries";

interface ViewOfPage {
  /** The page, of `common:pages`. */
  page: string;
  /** Its name is a text of `palette:views`. */
  name: string;
  address: string;
  permission?: Permission;
  isOfAccounts?: true;
}

const VIEWS: readonly ViewOfPage[] = [
  { page: "people", name: "users", address: addresses.people({ view: "users" }), permission: "managePeople", isOfAccounts: true },
  { page: "people", name: "invitations", address: addresses.people({ view: "invitations" }), permission: "managePeople", isOfAccounts: true },
  { page: "people", name: "tokens", address: addresses.people({ view: "tokens" }), permission: "managePeople", isOfAccounts: true },
  { page: "people", name: "stations", address: addresses.people({ view: "stations" }), permission: "configure", isOfAccounts: true },
  { page: "people", name: "audit", address: addresses.people({ view: "audit" }), permission: "readAudit" },
  { page: "people", name: "sessions", address: addresses.people({ view: "sessions" }), isOfAccounts: true },
  { page: "statistics", name: "agents", address: `${addresses.statistics()}?view=agents` },
  { page: "statistics", name: "mapping", address: `${addresses.statistics()}?view=mapping` },
  { page: "alerting", name: "routes", address: "/admin/alerts?view=routes" },
  { page: "alerting", name: "channels", address: "/admin/alerts?view=channels" },
  { page: "alerting", name: "sent", address: "/admin/alerts?view=sent" },
];

/** The pages of `places`, which are those that are offered, in the language of the page. */
export function pageEntries(places: readonly Place[]): Entry[] {
  const pageName = (name: string) => i18next.t(`common:pages.${name}`);
  const pages = places.flatMap((place) => place.pages.map((page) => ({ ...page, place: i18next.t(`common:places.${place.name}`) })));
  const names = new Set(pages.map(({ name }) => name));
  const hasAccounts = currentSession().hasAccounts;
  const views = VIEWS.filter(({ page, permission, isOfAccounts }) => names.has(page) && (permission === undefined || mayDo(permission)) && (isOfAccounts !== true || hasAccounts));
  return [
    ...[...pages, { ...ALERTS_PAGE, place: "" }].map(({ name, path, place }) => entryOf({ id: `page/${path}`, kind: "page", name: pageName(name), detail: place === pageName(name) ? "" : place, address: path, more: [name] })),
    ...views.map(({ page, name, address }) => entryOf({ id: `page/${address}`, kind: "page", name: i18next.t(`palette:views.${name}`), detail: pageName(page), address, more: [name] })),
  ];
}
