/** The value of a Device as one line without braces and URNs, whatever a component has written. */

import { number } from "~/design/numbers";
import { plainValue } from "~/live/readable";

const MAX_CHARACTERS = 120;

export function valueInWords(value: unknown, language: string): string | null {
  if (value === null || value === undefined) return null;
  const text = inWords(value, language);
  return text.length <= MAX_CHARACTERS ? text : `${text.slice(0, MAX_CHARACTERS - 1)}…`;
}

function inWords(value: unknown, language: string): string {
  if (typeof value === "number") return number(value, language, { maximumFractionDigits: 3 });
  // Separate numbers without commas, which some languages use as the decimal separator.
  if (Array.isArray(value)) return value.map((item) => inWords(item, language)).join(" · ");
  if (typeof value !== "object" || value === null) return plainValue(value);
  return Object.entries(value)
    .map(([name, part]) => `${name} ${inWords(part, language)}`)
    .join("; ");
}
