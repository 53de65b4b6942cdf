/** Variables that a person edits as JSON: what is wrong with the text, and which variables it changes. */

export type VariablesFault =
  | { fault: "syntax"; line: number | null }
  | { fault: "notAnObject" }
  | { fault: "name"; name: string }
  | { fault: "removed"; name: string };

export type Edited = { values: Record<string, unknown> } | VariablesFault;

const NAME = /^[A-Za-z_]\w{0,99}$/;

/** The variables as text to edit. */
export function variablesText(variables: Readonly<Record<string, unknown>>): string {
  return JSON.stringify(variables, null, 2);
}

/**
 * Read the text: the variables that differ from `before`, or what is wrong with it. A variable of `before` cannot be
 * removed, only changed.
 */
export function editedVariables(text: string, before: Readonly<Record<string, unknown>>): Edited {
  let read: unknown;
  try {
    read = JSON.parse(text.trim() === "" ? "{}" : text);
  } catch (error) {
    return { fault: "syntax", line: lineOf(error, text) };
  }
  if (typeof read !== "object" || read === null || Array.isArray(read)) return { fault: "notAnObject" };
  const values = read as Record<string, unknown>;
  const bad = Object.keys(values).find((name) => !NAME.test(name) && !Object.hasOwn(before, name));
  if (bad !== undefined) return { fault: "name", name: bad };
  const removed = Object.keys(before).find((name) => !Object.hasOwn(values, name));
  if (removed !== undefined) return { fault: "removed", name: removed };
  return {
    values: Object.fromEntries(
      Object.entries(values).filter(([name, value]) => !Object.hasOwn(before, name) || !isEqual(before[name], value)),
    ),
  };
}

/** The line of a syntax error: browsers state it, or the position, in their messages. */
function lineOf(error: unknown, text: string): number | null {
  const said = error instanceof Error ? error.message : "";
  const line = /line (\d+)/.exec(said)?.[1];
  if (line !== undefined) return Number(line);
  const position = /position (\d+)/.exec(said)?.[1];
  if (position !== undefined) return text.slice(0, Number(position)).split("\n").length;
  return /end of (JSON|data)/i.test(said) ? text.split("\n").length : null;
}

/** Whether two values are the same JSON; the order of members does not count. */
function isEqual(one: unknown, other: unknown): boolean {
  if (one === other) return true;
  if (typeof one !== "object" || typeof other !== "object" || one === null || other === null) return false;
  if (Array.isArray(one) !== Array.isArray(other)) return false;
  const [first, second] = [one as Record<string, unknown>, other as Record<string, unknown>];
  const names = Object.keys(first);
  return names.length === Object.keys(second).length && names.every((name) => Object.hasOwn(second, name) && isEqual(first[name], second[name]));
}
