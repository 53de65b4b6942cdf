/** Alert routes and channels as forms: their fields, and the way there and back. */
import type { FormField } from "~/api/generated/task-orchestrator";
import { field } from "~/tasks/field";
import { draftOf, entered, type Draft, type Entered } from "~/tasks/form";
import { SEVERITIES, type Channel, type Route } from "./api";

export const DAYS = ["mon", "tue", "wed", "thu", "fri", "sat", "sun"] as const;
export const CHANNELS = ["mail", "webhook"] as const;
const LISTS = ["categories", "subCategories", "sources", "places"] as const;
const SHOWN_SECONDS = 5; // "08:00" of "08:00:00"

type Translate = (key: string) => string;

/** The fields of a route; `t` translates the namespace "alerting". */
export function fieldsOfRoute(t: Translate, channels: readonly string[]): FormField[] {
  const one = (path: string, kind: FormField["kind"], name = path, over: Partial<FormField> = {}) => field({ path, kind, label: t(`route.${name}`), ...over });
  const group = (path: string, fields: FormField[]) => field({ path, kind: "group", label: t(`route.${path}`), fields });
  const severity = (path: string, initial: string) =>
    one(path, "choice", path, { options: SEVERITIES.map((value) => ({ value, label: t(`severity.${value}`) })), isRequired: true, initial });
  const toChannels = (over: Partial<FormField> = {}) =>
    one("channels", "choices", "channels", { options: channels.map((value) => ({ value, label: value })), isRequired: true, ...over });
  const hours = (path: string) =>
    one(path, "list", path, {
      fields: [
        one("days", "choices", "days", { options: DAYS.map((value) => ({ value, label: t(`days.${value}`) })), isRequired: true, initial: DAYS }),
        one("begin", "time", "begin", { isRequired: true }),
        one("end", "time", "end", { isRequired: true }),
      ],
    });
  const words = (path: string) => one(path, "text", path, { hint: t(`route.hint.${path}`) });
  return [
    group("to", [toChannels(), one("sendCleared", "boolean", "sendCleared", { initial: true }), one("enabled", "boolean", "enabled", { initial: true })]),
    group("which", [severity("minimumSeverity", "medium"), ...LISTS.map(words)]),
    group("when", [one("timeZone", "text", "timeZone", { isRequired: true, initial: Intl.DateTimeFormat().resolvedOptions().timeZone }), hours("hours"), hours("quietHours"), severity("urgentSeverity", "critical")]),
    one("escalations", "list", "escalations", { fields: [one("afterS", "number", "afterS", { unit: "s", isRequired: true, minimum: 1 }), toChannels()] }),
  ];
}

export function draftOfRoute(fields: readonly FormField[], route: Route | null): Draft {
  if (route === null) return draftOf(fields, null);
  const lists = Object.fromEntries(LISTS.map((name) => [name, (route[name] ?? []).join(", ")]));
  const inHours = (name: "hours" | "quietHours") => (route[name] ?? []).map(({ days, begin = "", end = "" }) => ({ days: days ?? DAYS, begin: begin.slice(0, SHOWN_SECONDS), end: end.slice(0, SHOWN_SECONDS) }));
  return draftOf(fields, { ...route, ...lists, hours: inHours("hours"), quietHours: inHours("quietHours") });
}

/** The route that was entered. */
export function enteredRoute(fields: readonly FormField[], draft: Draft): { route: Route; faults: Entered["faults"] } {
  const { values, faults } = entered(fields, draft);
  const lists = Object.fromEntries(LISTS.map((name) => [name, listed(values[name])]));
  return { route: { ...values, ...lists } as unknown as Route, faults };
}

/** The fields of a channel of a type. A messenger is in the file, so it is only shown. */
export function fieldsOfChannel(t: Translate, type: string): FormField[] {
  const one = (path: string, kind: FormField["kind"], name = path, over: Partial<FormField> = {}) => field({ path, kind, label: t(`channel.${name}`), ...over });
  const types = type === "apprise" ? ["apprise"] : CHANNELS;
  const special: Record<string, FormField[]> = {
    mail: [one("to", "text", "to", { isRequired: true, hint: t("channel.hint.to") })],
    webhook: [one("url", "text", "url", { isRequired: true }), one("secret", "text", "secret", { minLength: 16, maxLength: 200, hint: t("channel.hint.secret") })],
  };
  return [
    one("type", "choice", "type", { options: types.map((value) => ({ value, label: t(`channel.types.${value}`) })), isRequired: true, initial: types[0] }),
    ...(special[type] ?? []),
    field({
      path: "throttle", kind: "group", label: t("channel.throttle"),
      fields: [
        one("throttle.maximum", "integer", "maximum", { initial: 20, minimum: 1, maximum: 10_000, isRequired: true }),
        one("throttle.perS", "number", "perS", { initial: 600, minimum: 1, maximum: 86_400, unit: "s", isRequired: true, hint: t("channel.hint.perS") }),
      ],
    }),
  ];
}

export function typeOf(draft: Draft, fallback: string): string {
  return fallback === "apprise" ? fallback : (CHANNELS[Number(draft["type"])] ?? "mail");
}

/** The entries that show a channel; its secret is never shown. */
export function draftOfChannel(fields: readonly FormField[], channel: Channel | null): Draft {
  if (channel === null) return draftOf(fields, null);
  const to = "to" in channel ? { to: channel.to.join(", ") } : {};
  return draftOf(fields, { ...channel, ...to, secret: undefined });
}

export function enteredChannel(fields: readonly FormField[], draft: Draft): { channel: Channel; faults: Entered["faults"] } {
  const { values, faults } = entered(fields, draft);
  return { channel: { ...values, ...(values["type"] === "mail" ? { to: listed(values["to"]) } : {}) } as unknown as Channel, faults };
}

function listed(text: unknown): string[] {
  return typeof text === "string" ? text.split(/[,;\s]+/).filter((word) => word !== "") : [];
}
