import { expect, test } from "vitest";
import { alertOf } from "./alert.fixture";
import { attentionOf, isUrgent, kindOf } from "./attention";

test("only new alerts count, and the newest of the highest priority is the worst", () => {
  const attention = attentionOf([
    alertOf("acknowledged", { priority: "critical", state: "acknowledged" }),
    alertOf("shelved", { priority: "critical", state: "shelved" }),
    alertOf("over", { priority: "critical", state: "returnedToNormal" }),
    alertOf("old", { dateIssued: "2026-01-01T07:00:00Z" }),
    alertOf("new", { dateIssued: "2026-01-01T09:00:00Z" }),
    alertOf("low", { priority: "low", dateIssued: "2026-01-01T10:00:00Z" }),
  ]);
  expect(attention.count).toBe(3);
  expect(attention.byPriority).toEqual({ low: 1, medium: 0, high: 2, critical: 0 });
  expect(attention.worst?.id).toBe("new");
  expect(attentionOf([]).worst).toBeNull();
});

test("urgent is what is new and of high or critical priority", () => {
  expect((["low", "medium", "high", "critical"] as const).map((priority) => isUrgent(alertOf("a", { priority })))).toEqual([false, false, true, true]);
  expect(isUrgent(alertOf("a", { state: "acknowledged" }))).toBe(false);
});

test("the page explains the kinds that it knows, the subcategory before the category", () => {
  expect(kindOf({ category: "device", subCategory: "gloveSilent" })).toBe("gloveSilent");
  expect(kindOf({ category: "process", subCategory: "processFailed" })).toBe("processFailed");
  expect(kindOf({ category: "process", subCategory: "processIncident" })).toBe("processIncident");
  expect(kindOf({ category: "task", subCategory: "taskNotAccepted" })).toBe("taskNotAccepted");
  expect(kindOf({ category: "traffic", subCategory: "accident" })).toBe("other");
});
