/** The value of any device in a few words: whatever a component wrote there, it fits into a row. */

import { number } from "~/design/numbers";

const MOST = 80;

export function valueInWords(value: unknown, language: string): string | null {
  if (value === null || value === undefined) return null;
  const text = inWords(value, language);
  return text.length <= MOST ? text : `${text.slice(0, MOST - 1)}…`;
}

function inWords(value: unknown, language: string): string {
  if (typeof value === "string") return value;
  if (typeof value === "number") return number(value, language, { maximumFractionDigits: 3 });
  // A list has no commas between its numbers, since some languages have them within.
  if (Array.isArray(value) && value.every((one) => typeof one === "number")) return value.map((one) => inWords(one, language)).join(" · ");
  return JSON.stringify(value);
}
