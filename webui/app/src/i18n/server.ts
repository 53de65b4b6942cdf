/**
* Messages of servers in the language of the page: they send an English text with a code and parameters, and
* `server.json` has the text of each code. Texts with an unknown code stay in English.
 */
import i18next from "i18next";
import { number } from "~/design/numbers";
import { clockTime } from "~/design/times";

/** A moment among the parameters of a message, such as 2026-05-04T08:00:00Z. */
const MOMENT = /^\d{4}-\d{2}-\d{2}T\d{2}:\d{2}:\d{2}Z$/;

export interface Said {
  text: string;
  code: string | null;
  parameters: Record<string, unknown>;
}

/** Read the member `name` of a JSON object with its code and parameters; null without a text. */
export function eventText(members: object, name: string): Said | null {
  const of = members as Record<string, unknown>;
  const text = of[name];
  if (typeof text !== "string") return null;
  const code = of[`${name}Code`];
  const parameters = of[`${name}Parameters`];
  return {
    text,
    code: typeof code === "string" ? code : null,
    parameters: typeof parameters === "object" && parameters !== null ? (parameters as Record<string, unknown>) : {},
  };
}

/** Return a text in the language of the page. */
export function inWords({ text, code, parameters }: Said): string {
  if (code === null || !i18next.exists(`server:${code}`)) return text;
  const words = Object.entries(parameters).map(([name, value]) => [name, asWord(value)]);
  return i18next.t(`server:${code}`, Object.fromEntries(words) as Record<string, string>);
}

/** Return the member `name` of a JSON object in the language of the page; null without a text. */
export function localizedText(members: object, name: string): string | null {
  const text = eventText(members, name);
  return text === null ? null : inWords(text);
}

function asWord(value: unknown): string {
  if (typeof value === "number") return number(value, i18next.language, { maximumFractionDigits: 3 });
  if (typeof value === "object" && value !== null) return localizedText(value, "text") ?? "";
  if (typeof value === "string" && MOMENT.test(value)) return clockTime(value, i18next.language);
  return typeof value === "string" || typeof value === "boolean" ? String(value) : "";
}
