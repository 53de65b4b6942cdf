/**
 * The parameters of a process at its start. A definition gives each a default, and the default's JSON
 * type says what can be typed: text, a number, yes or no, or JSON for a list or an object.
 */
import type { DefinitionView } from "~/api/generated/task-orchestrator";

export type Parameter = DefinitionView["parameters"][number];
export type Kind = "text" | "number" | "boolean" | "json";

export type Fault = "required" | "notANumber" | "notJson";

export interface Filled {
  values: Record<string, unknown>;
  faults: Record<string, Fault>;
}

export function kindOf(parameter: Parameter): Kind {
  switch (typeof parameter.default) {
    case "number":
      return "number";
    case "boolean":
      return "boolean";
    case "object":
      return parameter.default === null ? "text" : "json";
    default:
      return "text";
  }
}

/** The initial text of the field. */
export function initialText(parameter: Parameter): string {
  const { default: value } = parameter;
  if (value === null || value === undefined) return "";
  return typeof value === "string" ? value : JSON.stringify(value);
}

/** What was typed, read by kind. An empty field that is not required leaves its parameter to the default. */
export function filledIn(parameters: readonly Parameter[], typed: Readonly<Record<string, string>>): Filled {
  const filled: Filled = { values: {}, faults: {} };
  for (const parameter of parameters) {
    const text = typed[parameter.name] ?? initialText(parameter);
    if (text.trim() === "") {
      if (parameter.required) filled.faults[parameter.name] = "required";
      else if (kindOf(parameter) === "text" && initialText(parameter) !== "") filled.values[parameter.name] = text;
      continue;
    }
    const read = readAs(kindOf(parameter), text);
    if ("fault" in read) filled.faults[parameter.name] = read.fault;
    else filled.values[parameter.name] = read.value;
  }
  return filled;
}

/** The parameter that a refusal speaks of (it names it in quotes), or null if it speaks of none or several. */
export function parameterIn(detail: string, parameters: readonly Parameter[]): string | null {
  const named = parameters.filter((parameter) => detail.includes(`"${parameter.name}"`));
  return named.length === 1 ? (named[0]?.name ?? null) : null;
}

function readAs(kind: Kind, text: string): { value: unknown } | { fault: Fault } {
  switch (kind) {
    case "text":
      return { value: text };
    case "boolean":
      return { value: text === "true" };
    case "number": {
      // A decimal comma is what two of three languages of this page are typed with.
      const value = Number(text.trim().replace(",", "."));
      return Number.isFinite(value) ? { value } : { fault: "notANumber" };
    }
    case "json":
      try {
        return { value: JSON.parse(text) as unknown };
      } catch {
        return { fault: "notJson" };
      }
  }
}
