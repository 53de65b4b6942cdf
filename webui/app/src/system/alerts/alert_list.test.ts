import { describe, expect, test } from "vitest";
import { alertOf } from "~/alerts/alert.fixture";
import { grouped, passes, sortAlerts, valuesOf } from "./alert_list";

const everything = { state: "", severity: "", category: "", source: "", text: "" };
const ids = (alerts: readonly { id: string }[]) => alerts.map((alert) => alert.id);

describe("filtering", () => {
  test("shows what is active unless a state is asked for", () => {
    const alerts = (["new", "acknowledged", "shelved", "returnedToNormal"] as const).map((state) => alertOf(state, { state }));
    const passing = (state: string) => ids(alerts.filter((alert) => passes(alert, { ...everything, state }, "")));
    expect(passing("")).toEqual(["new", "acknowledged"]);
    expect(passing("shelved")).toEqual(["shelved"]);
    expect(passing("all")).toHaveLength(4);
  });

  test("looks for every word in what the page says and in what the alert states", () => {
    const alert = alertOf("a", { description: "conveyor 3 is blocked" });
    expect(passes(alert, { ...everything, text: "störung CONVEYOR" }, "Störung")).toBe(true);
    expect(passes(alert, { ...everything, text: "glove-1" }, "")).toBe(true);
    expect(passes(alert, { ...everything, text: "conveyor 4" }, "")).toBe(false);
    expect(passes(alert, { ...everything, severity: "low" }, "")).toBe(false);
  });
});

describe("order", () => {
  const alerts = [
    alertOf("old", { dateIssued: "2026-01-01T07:00:00Z" }),
    alertOf("low", { severity: "low", priority: "low" }),
    alertOf("new", { dateIssued: "2026-01-01T09:00:00Z" }),
    alertOf("critical", { severity: "critical", priority: "critical" }),
  ];
  const title = (alert: { id: string }) => alert.id;

  test("by severity has the newest first among equals", () => {
    expect(ids(sortAlerts(alerts, { by: "severity", isDescending: true }, title))).toEqual(["critical", "new", "old", "low"]);
  });

  test("is the other way round when asked, by any column", () => {
    expect(ids(sortAlerts(alerts, { by: "severity", isDescending: false }, title))[0]).toBe("low");
    expect(ids(sortAlerts(alerts, { by: "title", isDescending: false }, title))).toEqual(["critical", "low", "new", "old"]);
    expect(ids(sortAlerts(alerts, { by: "raised", isDescending: true }, title))[0]).toBe("new");
  });
});

test("groups stand in the order of their first alert, with how many they have", () => {
  const alerts = [alertOf("1", { category: "b" }), alertOf("2", { category: "a" }), alertOf("3", { category: "b" })];
  const lines = grouped(alerts, "category", (group, count) => `${group} ${count}`);
  expect(lines.map((line) => (line.kind === "group" ? line.name : line.key))).toEqual(["b 2", "1", "3", "a 1", "2"]);
  expect(valuesOf(alerts, "category")).toEqual(["a", "b"]);
});
