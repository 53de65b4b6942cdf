import { describe, expect, test } from "vitest";
import { alertOf } from "~/alerts/alert.fixture";
import { passes, valuesOf } from "./alert_list";

const everything = { state: "", severity: "", category: "", source: "", text: "" };
const ids = (alerts: readonly { id: string }[]) => alerts.map((alert) => alert.id);

describe("filtering", () => {
  test("shows active alerts unless a state is selected", () => {
    const alerts = (["new", "acknowledged", "shelved", "returnedToNormal"] as const).map((state) => alertOf(state, { state }));
    const passing = (state: string) => ids(alerts.filter((alert) => passes(alert, { ...everything, state }, "")));
    expect(passing("")).toEqual(["new", "acknowledged"]);
    expect(passing("shelved")).toEqual(["shelved"]);
    expect(passing("all")).toHaveLength(4);
  });

  test("searches every word in the title and in the values of the alert", () => {
    const alert = alertOf("a", { description: "conveyor 3 is blocked" });
    expect(passes(alert, { ...everything, text: "störung CONVEYOR" }, "Störung")).toBe(true);
    expect(passes(alert, { ...everything, text: "glove-1" }, "")).toBe(true);
    expect(passes(alert, { ...everything, text: "conveyor 4" }, "")).toBe(false);
    expect(passes(alert, { ...everything, severity: "low" }, "")).toBe(false);
  });
});

test("the values on offer are those that occur, sorted", () => {
  const alerts = [alertOf("1", { category: "b" }), alertOf("2", { category: "a" }), alertOf("3", { category: "b" })];
  expect(valuesOf(alerts, "category")).toEqual(["a", "b"]);
});
