/** The mapping as it is edited: the entries of a version, and what has been changed since. */
import type { AgentView, MappedName, MappingEntry, UsedNameView } from "~/api/generated/task-orchestrator";
import { shortName } from "~/live/urn";

export const KINDS = ["definition", "class", "topic", "jobType", "assignee", "candidateGroup", "lane"] as const;
export type Kind = (typeof KINDS)[number];

/** Changes by the key of the entry; null removes it. They survive that somebody else changes the mapping. */
export type Changes = ReadonlyMap<string, MappingEntry | null>;

export const NO_CHANGES: Changes = new Map();

export function keyOf({ kind, name }: Pick<MappingEntry, "kind" | "name">): string {
  return `${kind} ${name}`;
}

/** The entries with the changes. */
export function applied(entries: readonly MappedName[], changes: Changes): MappingEntry[] {
  const kept = entries.filter((entry) => !changes.has(keyOf(entry)));
  const changed = [...changes.values()].filter((entry) => entry !== null);
  return [...kept, ...changed];
}

export function withChange(changes: Changes, before: Pick<MappingEntry, "kind" | "name"> | null, after: MappingEntry | null): Changes {
  const all = new Map(changes);
  if (before !== null) all.set(keyOf(before), null);
  if (after !== null) all.set(keyOf(after), after);
  return all;
}

export const TARGETS = ["resource", "role", "skills"] as const;
export type Target = (typeof TARGETS)[number];

export function targetOf(entry: MappingEntry): Target {
  return TARGETS.find((target) => entry[target] != null) ?? "resource";
}

/** "Device:ur10-1", "welder", "grip, place". */
export function valueOf(entry: MappingEntry): string {
  return entry.resource ?? entry.role ?? (entry.skills ?? []).join(", ");
}

export interface Draft {
  kind: Kind;
  name: string;
  target: Target;
  value: string;
  definition: string;
  parameters: string;
}

/** The entry of a form; null while something is missing or the parameters are no JSON object. */
export function entryOf({ kind, name, target, value, definition, parameters }: Draft): MappingEntry | null {
  const skills = value.split(",").map((skill) => skill.trim()).filter((skill) => skill !== "");
  const given = parametersOf(parameters);
  if (name.trim() === "" || skills.length === 0 || given === null) return null;
  if (target === "resource" && !/^(urn:\S+|[A-Z][A-Za-z0-9]*:[A-Za-z0-9_.-]+)$/.test(value.trim())) return null;
  return {
    kind,
    name: name.trim(),
    ...(target === "skills" ? { skills } : { [target]: value.trim() }),
    ...(definition.trim() === "" ? {} : { definition: definition.trim() }),
    ...(Object.keys(given).length === 0 ? {} : { parameters: given }),
  };
}

export function draftOf(entry: MappingEntry): Draft {
  const parameters = entry.parameters ?? {};
  return {
    kind: entry.kind,
    name: entry.name,
    target: targetOf(entry),
    value: valueOf(entry),
    definition: entry.definition ?? "",
    parameters: Object.keys(parameters).length === 0 ? "" : JSON.stringify(parameters),
  };
}

export function parametersOf(text: string): Record<string, unknown> | null {
  if (text.trim() === "") return {};
  try {
    const value: unknown = JSON.parse(text);
    return typeof value === "object" && value !== null && !Array.isArray(value) ? (value as Record<string, unknown>) : null;
  } catch {
    return null;
  }
}

/** Names in definitions that no entry maps, with the changes that are not confirmed yet. */
export function unmapped(names: readonly UsedNameView[], entries: readonly MappingEntry[]): UsedNameView[] {
  const mapped = new Set(entries.map(keyOf));
  return names.filter((used) => !mapped.has(keyOf(used)));
}

/** What agents can be named by: "Device:ur10-1" of the URN. */
export function references(agents: readonly AgentView[]): string[] {
  return agents.map(({ id }) => `${id.split(":")[2] ?? "Device"}:${shortName(id)}`);
}

/** All roles or skills of agents. */
export function offered(agents: readonly AgentView[], target: "role" | "skills"): string[] {
  const all = agents.flatMap((agent) => (target === "role" ? agent.roles : Object.keys(agent.skills)));
  return [...new Set(all)].sort();
}
