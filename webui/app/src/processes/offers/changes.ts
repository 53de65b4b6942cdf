/** Texts of what an offer would change. */
import type { OfferedChange } from "~/api/generated/task-orchestrator";

const MAX_LENGTH = 120;

/** "Pick (added)" for an element of a process, "gesture: Horns → Thumbs up" for an attribute. */
export function changeText({ process, element, name, change, before, after }: OfferedChange, nameOf: (kind: OfferedChange["change"]) => string): string {
  if (process !== null) return `${name ?? element} (${nameOf(change)})`;
  if (change === "added") return `${element}: ${valueText(after)}`;
  if (change === "removed") return `${element}: ${valueText(before)} (${nameOf(change)})`;
  return `${element}: ${valueText(before)} → ${valueText(after)}`;
}

function valueText(value: unknown): string {
  const text = typeof value === "string" ? value : JSON.stringify(value);
  return text.length > MAX_LENGTH ? `${text.slice(0, MAX_LENGTH)}…` : text;
}
