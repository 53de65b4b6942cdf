/** Texts and values of components for people: without braces, quotation marks and URNs. */
import { shortName } from "./urn";

const URN = /urn:ngsi-ld:[\w.-]+(?::[\w.%-]+)+/g;

/** A text in which URNs are short names, and which is no JSON; it begins with a capital letter. */
export function readable(text: string): string {
  const isJson = /^\s*[{[]/.test(text);
  return sentence(isJson ? ofJson(text) : text.replace(URN, (urn) => shortName(urn)));
}

/** A value on one line: "speed 0.5, at 1, 2". */
export function plainValue(value: unknown): string {
  if (value === null || value === undefined) return "–";
  if (typeof value === "string") return value.replace(URN, (urn) => shortName(urn));
  if (typeof value !== "object") return JSON.stringify(value); // a number, true or false
  if (Array.isArray(value)) return value.map(plainValue).join(", ");
  return Object.entries(value)
    .map(([name, part]) => `${name} ${plainValue(part)}`)
    .join(", ");
}

/** A sentence begins with a capital letter; a name with digits, dots or an underscore in its first word stays as it is. */
export function sentence(text: string): string {
  const [first = ""] = text.split(/\s/, 1);
  return /^\p{Ll}+[,:;.]?$/u.test(first) ? text.charAt(0).toLocaleUpperCase() + text.slice(1) : text;
}

function ofJson(text: string): string {
  try {
    return plainValue(JSON.parse(text));
  } catch {
    return text;
  }
}
