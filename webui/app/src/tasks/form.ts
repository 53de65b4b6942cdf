/** What a person enters into the form of a Task, and the values and faults of it. The server has the last word. */
import type { FormField } from "~/api/generated/task-orchestrator";

/** The entry of a field: text, a checked box, the numbers of chosen options, or the items of a list. */
export type Entry = string | boolean | string[] | Draft[];
// eslint-disable-next-line @typescript-eslint/consistent-indexed-object-style -- a record cannot refer to itself
export interface Draft {
  [path: string]: Entry;
}

export interface FieldFault {
  code: "required" | "notANumber" | "notAnInteger" | "tooSmall" | "tooLarge" | "tooShort" | "tooLong" | "pattern" | "notJson" | "decimals";
  limit?: number;
}

export interface Entered {
  values: Record<string, unknown>;
  /** By path; that of an item of a list is `holes.1.mm`. */
  faults: Record<string, FieldFault>;
}

const SHOWN_ONLY: readonly FormField["kind"][] = ["note", "image", "link", "table", "separator"];
const LOCAL_MOMENT = 16; // "2026-03-02T08:00"

/** The fields with a value of their own, those within groups included. */
export function inputs(fields: readonly FormField[]): FormField[] {
  return fields.flatMap((field) => {
    if (field.kind === "group") return inputs(field.fields);
    return SHOWN_ONLY.includes(field.kind) ? [] : [field];
  });
}

/** The entry that shows a value; by default the initial one. */
export function entryOf(field: FormField, value: unknown = field.initial): Entry {
  switch (field.kind) {
    case "boolean":
      return value === true;
    case "choice":
      return numberOf(field, value);
    case "choices":
      return Array.isArray(value) ? value.map((one) => numberOf(field, one)).filter((nth) => nth !== "") : [];
    case "list":
      return Array.isArray(value) ? value.map((item) => draftOf(field.fields, item)) : [];
    case "datetime":
      return typeof value === "string" ? localMoment(value) : "";
    case "json":
      return value === null || value === undefined ? "" : JSON.stringify(value, null, 2);
    default:
      if (value === null || value === undefined) return "";
      return typeof value === "string" ? value : JSON.stringify(value);
  }
}

/** The entries of an item of a list; a field without a path is the item itself. */
export function draftOf(fields: readonly FormField[], item: unknown): Draft {
  return Object.fromEntries(inputs(fields).map((field) => [field.path, entryOf(field, field.path === "" ? item : (valueAt(item, field.path) ?? field.initial))]));
}

/** The values and faults of entries; an empty one that is not required sets nothing. */
export function entered(fields: readonly FormField[], draft: Draft): Entered {
  const found: Entered = { values: {}, faults: {} };
  for (const field of inputs(fields)) {
    if (field.kind === "computed") continue;
    const read = valueOf(field, draft[field.path] ?? entryOf(field), field.path);
    Object.assign(found.faults, read.faults);
    if (read.value !== undefined) putAt(found.values, field.path, read.value);
  }
  return found;
}

interface Read {
  value?: unknown;
  faults?: Record<string, FieldFault>;
}

function valueOf(field: FormField, entry: Entry, path: string): Read {
  if (field.isReadOnly) return { value: field.initial ?? undefined };
  const fault = (code: FieldFault["code"], limit?: number | null): Read => ({ faults: { [path]: limit == null ? { code } : { code, limit } } });
  if (field.kind === "list") return listOf(field, Array.isArray(entry) ? (entry as Draft[]) : [], path);
  if (field.kind === "boolean") return entry !== true && field.isRequired ? fault("required") : { value: entry === true };
  if (field.kind === "choices") {
    const chosen = Array.isArray(entry) ? (entry as string[]) : [];
    if (chosen.length === 0) return field.isRequired ? fault("required") : {};
    return { value: chosen.map((nth) => field.options[Number(nth)]?.value) };
  }
  const text = typeof entry === "string" ? entry.trim() : "";
  if (text === "") return field.isRequired ? fault("required") : {};
  switch (field.kind) {
    case "choice":
      return { value: field.options[Number(text)]?.value };
    case "number":
    case "integer":
      return numberFrom(field, text, fault);
    case "json":
      try {
        return { value: JSON.parse(text) as unknown };
      } catch {
        return fault("notJson");
      }
    case "datetime":
      return { value: new Date(text).toISOString() };
    case "date":
    case "time":
      return { value: text };
    default:
      if (field.minLength !== null && text.length < field.minLength) return fault("tooShort", field.minLength);
      if (field.maxLength !== null && text.length > field.maxLength) return fault("tooLong", field.maxLength);
      return isMatch(text, field.pattern) ? { value: text } : fault("pattern");
  }
}

function numberFrom(field: FormField, text: string, fault: (code: FieldFault["code"], limit?: number | null) => Read): Read {
  const value = Number(text.replace(",", "."));
  if (!Number.isFinite(value)) return fault("notANumber");
  if (field.kind === "integer" && !Number.isInteger(value)) return fault("notAnInteger");
  if (field.minimum !== null && value < field.minimum) return fault("tooSmall", field.minimum);
  if (field.maximum !== null && value > field.maximum) return fault("tooLarge", field.maximum);
  const places = /[.,](\d+)$/.exec(text)?.[1]?.length ?? 0;
  if (field.decimals !== null && places > field.decimals) return fault("decimals", field.decimals);
  return { value: field.isText ? text.replace(",", ".") : value };
}

function listOf(field: FormField, items: readonly Draft[], path: string): Read {
  const faults: Record<string, FieldFault> = {};
  const values = items.map((item, nth) => {
    const found = entered(field.fields, item);
    for (const [inner, fault] of Object.entries(found.faults)) faults[inner === "" ? `${path}.${nth}` : `${path}.${nth}.${inner}`] = fault;
    return field.fields[0]?.path === "" ? found.values[""] : found.values;
  });
  return { value: values.filter((value) => value !== undefined), faults };
}

/** A pattern that this browser cannot read is checked by the server alone. */
function isMatch(text: string, pattern: string | null): boolean {
  if (pattern === null) return true;
  try {
    return new RegExp(pattern, "u").test(text);
  } catch {
    return true;
  }
}

function numberOf(field: FormField, value: unknown): string {
  const nth = field.options.findIndex((option) => JSON.stringify(option.value) === JSON.stringify(value));
  return nth < 0 ? "" : String(nth);
}

/** A moment as `datetime-local` has it, in the time zone of the reader. */
function localMoment(value: string): string {
  const moment = new Date(value);
  if (Number.isNaN(moment.getTime())) return "";
  return new Date(moment.getTime() - moment.getTimezoneOffset() * 60_000).toISOString().slice(0, LOCAL_MOMENT);
}

function valueAt(data: unknown, path: string): unknown {
  return path.split(".").reduce<unknown>((found, name) => (typeof found === "object" && found !== null ? (found as Record<string, unknown>)[name] : undefined), data);
}

function putAt(data: Record<string, unknown>, path: string, value: unknown): void {
  const names = path === "" ? [""] : path.split(".");
  let place = data;
  for (const name of names.slice(0, -1)) {
    const inner = place[name];
    if (typeof inner !== "object" || inner === null) place[name] = {};
    place = place[name] as Record<string, unknown>;
  }
  place[names.at(-1) ?? ""] = value;
}
