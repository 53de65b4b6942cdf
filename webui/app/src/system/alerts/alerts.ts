/** Alerts in the order in which a person wants them: those that stand first, the gravest on top. */
import type { AlertView, Severity } from "~/live/messages";

const gravity: Record<Severity, number> = { critical: 4, high: 3, medium: 2, low: 1, informational: 0 };

/** The kinds of alerts whose meaning the page can tell; any other speaks for itself. */
const known = new Set(["gloveSilent", "unknownGesture", "notTakenUp", "taskLost", "processFailed"]);

export interface Sorted {
  standing: AlertView[];
  past: AlertView[];
}

/** An acknowledged alert keeps its place: it stands for as long as its cause does. */
export function sorted(alerts: readonly AlertView[]): Sorted {
  const standing = alerts.filter((alert) => alert.validTo === null);
  const past = alerts.filter((alert) => alert.validTo !== null);
  return {
    standing: standing.sort(
      (a, b) => gravity[b.severity] - gravity[a.severity] || newestFirst(a.dateIssued, b.dateIssued) || byId(a, b),
    ),
    past: past.sort((a, b) => newestFirst(a.validTo ?? "", b.validTo ?? "") || byId(a, b)),
  };
}

/** The word under which `system:alert.kind` explains it. */
export function kindOf({ category, subCategory }: Pick<AlertView, "category" | "subCategory">): string {
  for (const word of [subCategory, category]) {
    if (word !== null && known.has(word)) return word;
  }
  return "other";
}

function newestFirst(a: string, b: string): number {
  return Date.parse(b) - Date.parse(a) || 0;
}

function byId(a: AlertView, b: AlertView): number {
  return a.id < b.id ? -1 : 1;
}
