/** The Alerts as a list: which pass the filter, in which order, in which groups. */
import { compareUrgency } from "~/alerts/attention";
import type { Line, Sorting } from "~/design/VirtualTable";
import { localizedText } from "~/i18n/server";
import type { AlertState, AlertView, Severity } from "~/live/messages";
import { shortName } from "~/live/urn";

export const SEVERITIES: readonly Severity[] = ["critical", "high", "medium", "low", "informational"];
export const STATES: readonly AlertState[] = ["new", "acknowledged", "shelved", "returnedToNormal"];
export const GROUPINGS = ["", "severity", "category", "source"] as const;
export type Grouping = (typeof GROUPINGS)[number];

export interface AlertFilter {
  /** "" for what is active (new or acknowledged), "all", or one state. */
  state: string;
  severity: string;
  category: string;
  source: string;
  text: string;
}

/** Whether an Alert passes; `said` is what the page says of it, in the language of the page. */
export function passes(alert: AlertView, filter: AlertFilter, said: string): boolean {
  const isActive = alert.state === "new" || alert.state === "acknowledged";
  if (filter.state === "" ? !isActive : filter.state !== "all" && alert.state !== filter.state) return false;
  if (filter.severity !== "" && alert.severity !== filter.severity) return false;
  if (filter.category !== "" && alert.category !== filter.category) return false;
  if (filter.source !== "" && alert.source !== filter.source) return false;
  const words = filter.text.toLowerCase().split(/\s+/).filter((word) => word !== "");
  const text = `${said}\n${alert.description}\n${localizedText(alert, "description") ?? ""}\n${alert.source}\n${alert.category}\n${alert.subCategory ?? ""}\n${alert.id}`.toLowerCase();
  return words.every((word) => text.includes(word));
}

/** By the column that `sorting` names; equal ones by urgency, so that the order never depends on chance. */
export function sortAlerts(alerts: readonly AlertView[], sorting: Sorting, titleOf: (alert: AlertView) => string): AlertView[] {
  const sign = sorting.isDescending ? -1 : 1;
  const compare = (a: AlertView, b: AlertView): number => {
    switch (sorting.by) {
      case "severity":
        return SEVERITIES.indexOf(b.severity) - SEVERITIES.indexOf(a.severity);
      case "state":
        return STATES.indexOf(b.state) - STATES.indexOf(a.state);
      case "title":
        return titleOf(a).localeCompare(titleOf(b));
      case "source":
        return shortName(a.source).localeCompare(shortName(b.source));
      default:
        return a.dateIssued < b.dateIssued ? -1 : a.dateIssued > b.dateIssued ? 1 : 0;
    }
  };
  return [...alerts].sort((a, b) => sign * compare(a, b) || compareUrgency(a, b));
}

/** The rows with a head for each group; groups come in the order of their first row. */
export function grouped(
  alerts: readonly AlertView[],
  grouping: Grouping,
  nameOf: (group: string, count: number) => string,
): Line<AlertView>[] {
  const row = (alert: AlertView): Line<AlertView> => ({ kind: "row", key: alert.id, row: alert });
  if (grouping === "") return alerts.map(row);
  const groups = new Map<string, AlertView[]>();
  for (const alert of alerts) {
    const members = groups.get(alert[grouping]);
    if (members === undefined) groups.set(alert[grouping], [alert]);
    else members.push(alert);
  }
  return [...groups].flatMap(([group, members]) => [
    { kind: "group", key: `group ${group}`, name: nameOf(group, members.length) } as const,
    ...members.map(row),
  ]);
}

/** What a select offers of the values that occur, by name. */
export function valuesOf(alerts: readonly AlertView[], member: "category" | "source"): string[] {
  return [...new Set(alerts.map((alert) => alert[member]))].sort();
}
