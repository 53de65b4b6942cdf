/** Which Alerts need attention, as the navigation and the banner state it: a count and the worst, never a list. */
import type { AlertPriority, AlertView } from "~/live/messages";

const rank: Record<AlertPriority, number> = { low: 0, medium: 1, high: 2, critical: 3 };

export interface Attention {
  /** Active Alerts that nobody has acknowledged and that are not shelved. */
  count: number;
  byPriority: Record<AlertPriority, number>;
  /** The newest of the highest priority; null if there is none. */
  worst: AlertView | null;
}

export function attentionOf(alerts: readonly AlertView[]): Attention {
  const byPriority: Record<AlertPriority, number> = { low: 0, medium: 0, high: 0, critical: 0 };
  let worst: AlertView | null = null;
  for (const alert of alerts) {
    if (alert.state !== "new") continue;
    byPriority[alert.priority] += 1;
    if (worst === null || compareUrgency(alert, worst) < 0) worst = alert;
  }
  return { count: Object.values(byPriority).reduce((sum, count) => sum + count, 0), byPriority, worst };
}

/** The more urgent first; of the same priority the newer first, then by id, so that the order is always the same. */
export function compareUrgency(a: AlertView, b: AlertView): number {
  return rank[b.priority] - rank[a.priority] || compareText(b.dateIssued, a.dateIssued) || compareText(a.id, b.id);
}

/** Whether an operator must learn of it at once. */
export function isUrgent(alert: AlertView): boolean {
  return alert.state === "new" && rank[alert.priority] >= rank.high;
}

/** The kinds of Alerts that the page explains; others are shown with their description. */
const knownKinds = new Set(["gloveSilent", "unknownGesture", "taskNotAccepted", "taskPastDue", "taskPerformerLost", "entityFilterRefused", "taskLost", "taskUnreadable", "processFailed", "processIncident"]);

/** The key of the explanation of an Alert: by subcategory, else by category, else "other". */
export function kindOf({ category, subCategory }: Pick<AlertView, "category" | "subCategory">): string {
  for (const word of [subCategory, category]) {
    if (word !== null && knownKinds.has(word)) return word;
  }
  return "other";
}

function compareText(a: string, b: string): number {
  return a < b ? -1 : a > b ? 1 : 0;
}
