/** The filter of the Alerts, and the values that it offers. */
import { localizedText } from "~/i18n/server";
import type { AlertState, AlertView, Severity } from "~/live/messages";

export const SEVERITIES: readonly Severity[] = ["critical", "high", "medium", "low", "informational"];
export const STATES: readonly AlertState[] = ["new", "acknowledged", "shelved", "returnedToNormal"];
export const GROUPINGS = ["", "severity", "category", "source"] as const;
export type AlertGrouping = (typeof GROUPINGS)[number];

export interface AlertFilter {
  /** "" for active Alerts (new or acknowledged), "all", or one state. */
  state: string;
  severity: string;
  category: string;
  source: string;
  text: string;
}

/** Whether an Alert passes; `title` is its title in the language of the page. */
export function passes(alert: AlertView, filter: AlertFilter, title: string): boolean {
  const isActive = alert.state === "new" || alert.state === "acknowledged";
  if (filter.state === "" ? !isActive : filter.state !== "all" && alert.state !== filter.state) return false;
  if (filter.severity !== "" && alert.severity !== filter.severity) return false;
  if (filter.category !== "" && alert.category !== filter.category) return false;
  if (filter.source !== "" && alert.source !== filter.source) return false;
  const words = filter.text.toLowerCase().split(/\s+/).filter((word) => word !== "");
  const text = `${title}\n${alert.description}\n${localizedText(alert, "description") ?? ""}\n${alert.source}\n${alert.category}\n${alert.subCategory ?? ""}\n${alert.id}`.toLowerCase();
  return words.every((word) => text.includes(word));
}

/** The values that occur, sorted. */
export function valuesOf(alerts: readonly AlertView[], member: "category" | "source"): string[] {
  return [...new Set(alerts.map((alert) => alert[member]))].sort();
}
