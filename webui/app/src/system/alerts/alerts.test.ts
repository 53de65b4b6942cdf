import { expect, test } from "vitest";
import type { AlertView } from "~/live/messages";
import { kindOf, sorted } from "./alerts";

function alert(id: string, rest: Partial<AlertView> = {}): AlertView {
  return {
    id, category: "device", subCategory: null, severity: "high", description: "", source: "urn:x", validTo: null,
    dateIssued: "2026-01-01T08:00:00Z", acknowledged: null, ...rest,
  };
}

test("alerts that stand come by gravity, then the newest first", () => {
  const alerts = [
    alert("old high", { dateIssued: "2026-01-01T07:00:00Z" }),
    alert("low", { severity: "low" }),
    alert("new high", { dateIssued: "2026-01-01T09:00:00Z" }),
    alert("critical", { severity: "critical", dateIssued: "2026-01-01T01:00:00Z" }),
  ];
  expect(sorted(alerts).standing.map((one) => one.id)).toEqual(["critical", "new high", "old high", "low"]);
});

test("an acknowledged alert keeps its place", () => {
  const alerts = [alert("a"), alert("b"), alert("c")];
  const before = sorted(alerts).standing.map((one) => one.id);
  const after = sorted(alerts.map((one) => (one.id === "a" ? { ...one, acknowledged: { by: "Anna", at: "" } } : one)));
  expect(after.standing.map((one) => one.id)).toEqual(before);
});

test("alerts that are over come apart, the last one first", () => {
  const { standing, past } = sorted([
    alert("early", { validTo: "2026-01-01T08:00:00Z" }),
    alert("stands"),
    alert("late", { validTo: "2026-01-01T09:00:00Z" }),
  ]);
  expect(standing.map((one) => one.id)).toEqual(["stands"]);
  expect(past.map((one) => one.id)).toEqual(["late", "early"]);
});

test("the page explains the kinds that it knows, the subcategory before the category", () => {
  expect(kindOf({ category: "device", subCategory: "gloveSilent" })).toBe("gloveSilent");
  expect(kindOf({ category: "processFailed", subCategory: null })).toBe("processFailed");
  expect(kindOf({ category: "taskOverdue", subCategory: "notTakenUp" })).toBe("notTakenUp");
  expect(kindOf({ category: "traffic", subCategory: "accident" })).toBe("other");
});
