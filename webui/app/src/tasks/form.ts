/** The form of a Task: the fields of a JSON Schema, and what a person has entered, read by type. */

export interface FormField {
  name: string;
  title: string;
  hint: string | null;
  kind: "text" | "number" | "integer" | "boolean" | "choice" | "json";
  options: readonly { value: unknown; name: string }[];
  isRequired: boolean;
  isReadOnly: boolean;
  initial: unknown;
}

export type FieldFault = "required" | "notANumber" | "notAnInteger" | "tooSmall" | "tooLarge" | "tooShort" | "tooLong" | "pattern" | "notJson";

export interface Entered {
  values: Record<string, unknown>;
  faults: Record<string, FieldFault>;
}

type Schema = Record<string, unknown>;

/** The fields of the properties of a schema, in its order; `inputs` fill those without a default. */
export function fieldsOf(form: Schema | null, inputs: Readonly<Record<string, unknown>> = {}): FormField[] {
  const properties = record(form?.["properties"]);
  const required = Array.isArray(form?.["required"]) ? (form["required"] as unknown[]) : [];
  return Object.entries(properties).map(([name, given]) => {
    const schema = record(given);
    const options = optionsOf(schema);
    return {
      name,
      title: text(schema["title"]) ?? name,
      hint: text(schema["description"]),
      kind: options.length > 0 ? "choice" : kindOf(schema["type"]),
      options,
      isRequired: required.includes(name),
      isReadOnly: schema["readOnly"] === true,
      initial: schema["default"] ?? inputs[name] ?? null,
    };
  });
}

/** The text in the field of a value; a choice is the number of its option. */
export function entryOf(field: FormField, value: unknown = field.initial): string {
  if (field.kind === "choice") {
    const nth = field.options.findIndex((option) => JSON.stringify(option.value) === JSON.stringify(value));
    return nth < 0 ? "" : String(nth);
  }
  if (field.kind === "boolean") return value === true ? "true" : "false";
  if (value === null || value === undefined) return "";
  return typeof value === "string" ? value : JSON.stringify(value);
}

/** Read the texts of the fields; an empty one that is not required sets nothing. */
export function entered(form: Schema | null, fields: readonly FormField[], typed: Readonly<Record<string, string>>): Entered {
  const properties = record(form?.["properties"]);
  const found: Entered = { values: {}, faults: {} };
  for (const field of fields) {
    const given = (typed[field.name] ?? entryOf(field)).trim();
    if (given === "") {
      if (field.isRequired) found.faults[field.name] = "required";
      continue;
    }
    const read = valueOf(field, given, record(properties[field.name]));
    if ("fault" in read) found.faults[field.name] = read.fault;
    else found.values[field.name] = read.value;
  }
  return found;
}

function valueOf(field: FormField, given: string, schema: Schema): { value: unknown } | { fault: FieldFault } {
  switch (field.kind) {
    case "boolean":
      return { value: given === "true" };
    case "choice":
      return { value: field.options[Number(given)]?.value };
    case "number":
    case "integer": {
      const value = Number(given.replace(",", "."));
      if (!Number.isFinite(value)) return { fault: "notANumber" };
      if (field.kind === "integer" && !Number.isInteger(value)) return { fault: "notAnInteger" };
      if (value < bound(schema["minimum"], -Infinity)) return { fault: "tooSmall" };
      return value > bound(schema["maximum"], Infinity) ? { fault: "tooLarge" } : { value };
    }
    case "json":
      try {
        return { value: JSON.parse(given) as unknown };
      } catch {
        return { fault: "notJson" };
      }
    case "text":
      if (given.length < bound(schema["minLength"], 0)) return { fault: "tooShort" };
      if (given.length > bound(schema["maxLength"], Infinity)) return { fault: "tooLong" };
      return matches(given, text(schema["pattern"])) ? { value: given } : { fault: "pattern" };
  }
}

/** A pattern that this browser cannot read is checked by the server alone. */
function matches(given: string, pattern: string | null): boolean {
  if (pattern === null) return true;
  try {
    return new RegExp(pattern, "u").test(given);
  } catch {
    return true;
  }
}

function optionsOf(schema: Schema): { value: unknown; name: string }[] {
  if (Array.isArray(schema["oneOf"])) {
    const titled = (schema["oneOf"] as unknown[]).map(record).filter((one) => "const" in one);
    return titled.map((one) => ({ value: one["const"], name: text(one["title"]) ?? String(one["const"]) }));
  }
  return Array.isArray(schema["enum"]) ? (schema["enum"] as unknown[]).map((value) => ({ value, name: String(value) })) : [];
}

function kindOf(type: unknown): FormField["kind"] {
  switch (type) {
    case "number":
    case "integer":
    case "boolean":
      return type;
    case "object":
    case "array":
      return "json";
    default:
      return "text";
  }
}

function record(value: unknown): Schema {
  return typeof value === "object" && value !== null && !Array.isArray(value) ? (value as Schema) : {};
}

function text(value: unknown): string | null {
  return typeof value === "string" && value !== "" ? value : null;
}

function bound(value: unknown, otherwise: number): number {
  return typeof value === "number" ? value : otherwise;
}
