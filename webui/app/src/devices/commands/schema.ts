/** The form of a command, made from the JSON Schema of its parameters. The gateway has the last word. */
import type { CommandSpecification, Joint } from "~/api/generated/device-gateway";
import type { FormField } from "~/api/generated/task-orchestrator";
import { field } from "~/tasks/field";
import { entered, type Draft, type Entered } from "~/tasks/form";
import { spaced } from "../values";

type Positions = Readonly<Record<string, { value: number }>>;
type Schema = Readonly<Record<string, unknown>>;

/** More numbers than this are entered as JSON. */
const MAX_NUMBERS = 40;
/** The field of a schema that has no form. */
const WHOLE = "parameters";

/**
 * The fields for the parameters of a command. A list of numbers, one for each joint, gets the names and limits of the
 * joints, and begins with their positions `now`.
 */
export function commandFields(command: CommandSpecification, joints: readonly Joint[], now: Positions = {}): FormField[] {
  const schema = command.parameters ?? {};
  const properties = schema["properties"];
  if (typeof properties !== "object" || properties === null) return isEmpty(schema) ? [] : [field({ path: WHOLE, kind: "json", label: spaced(WHOLE), initial: {} })];
  const required = Array.isArray(schema["required"]) ? (schema["required"] as unknown[]) : [];
  return Object.entries(properties as Record<string, Schema>).map(([name, property]) => fieldOf(name, property, required.includes(name), joints, now));
}

/** The parameters that were entered, and what is wrong with them. */
export function enteredParameters(fields: readonly FormField[], draft: Draft): { parameters: Record<string, unknown>; faults: Entered["faults"] } {
  const { values, faults } = entered(fields, draft);
  const [first] = fields;
  if (fields.length === 1 && first?.path === WHOLE && first.kind === "json") return { parameters: (values[WHOLE] ?? {}) as Record<string, unknown>, faults };
  for (const { path, kind, fields: parts } of fields) {
    if (kind !== "group") continue;
    const numbers = values[path] as Record<string, unknown> | undefined;
    if (numbers !== undefined) values[path] = parts.map((_, nth) => numbers[String(nth)] ?? null);
  }
  return { parameters: values, faults };
}

function fieldOf(path: string, schema: Schema, isRequired: boolean, joints: readonly Joint[], now: Positions): FormField {
  const common = { path, label: textOf(schema, "title") ?? spaced(path), hint: textOf(schema, "description"), isRequired, initial: schema["default"] ?? null };
  if (Array.isArray(schema["enum"])) return field({ ...common, kind: "choice", options: (schema["enum"] as unknown[]).map((value) => ({ value, label: String(value) })) });
  switch (schema["type"]) {
    case "number":
    case "integer":
      return field({ ...common, kind: schema["type"], ...limitsOf(schema) });
    case "boolean":
      // An empty box is an answer too.
      return field({ ...common, kind: "boolean", isRequired: false });
    case "string":
      return field({ ...common, kind: "text", minLength: numberIn(schema, "minLength"), maxLength: numberIn(schema, "maxLength"), pattern: textOf(schema, "pattern") });
    default: {
      const count = countOf(schema);
      return count === null ? field({ ...common, kind: "json" }) : field({ ...common, kind: "group", fields: numbersOf(path, count, schema, isRequired, joints, now) });
    }
  }
}

/** How many numbers a list of a fixed length has; null for other schemas. */
function countOf(schema: Schema): number | null {
  const [items, least, most] = [schema["items"] as Schema | undefined, numberIn(schema, "minItems"), numberIn(schema, "maxItems")];
  const isNumbers = schema["type"] === "array" && (items?.["type"] === "number" || items?.["type"] === "integer");
  return isNumbers && least !== null && least === most && least <= MAX_NUMBERS ? least : null;
}

function numbersOf(path: string, count: number, schema: Schema, isRequired: boolean, joints: readonly Joint[], now: Positions): FormField[] {
  const ofItem = limitsOf(schema["items"] as Schema);
  return Array.from({ length: count }, (_, nth) => {
    const joint = joints.length === count ? joints[nth] : undefined;
    const limits = joint === undefined ? ofItem : { minimum: joint.lower ?? ofItem.minimum, maximum: joint.upper ?? ofItem.maximum };
    const unit = joint === undefined ? null : joint.type === "prismatic" ? "m" : "rad";
    const position = joint === undefined ? undefined : now[joint.name]?.value;
    const initial = position === undefined ? null : Math.round(position * 1e4) / 1e4;
    return field({ path: `${path}.${nth}`, kind: "number", label: joint?.name ?? String(nth + 1), unit, isRequired, initial, ...limits });
  });
}

function limitsOf(schema: Schema): { minimum: number | null; maximum: number | null } {
  return { minimum: numberIn(schema, "minimum"), maximum: numberIn(schema, "maximum") };
}

function numberIn(schema: Schema, key: string): number | null {
  const value = schema[key];
  return typeof value === "number" ? value : null;
}

function textOf(schema: Schema, key: string): string | null {
  const value = schema[key];
  return typeof value === "string" ? value : null;
}

function isEmpty(schema: Schema): boolean {
  return Object.keys(schema).every((key) => key === "type");
}
