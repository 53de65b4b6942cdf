/** The value of a device as one line, whatever a component has written. */

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
  // Separate numbers without commas, which some languages use as the decimal separator.
  if (Array.isArray(value) && value.every((item) => typeof item === "number")) return value.map((item) => inWords(item, language)).join(" · ");
  return JSON.stringify(value);
}
