import { expect, test } from "vitest";
import type { MigrationFinding } from "~/api/generated/task-orchestrator";
import { elementsToMap } from "./Findings";

function finding(element: string, over: Partial<MigrationFinding> = {}): MigrationFinding {
  return { element, name: element, target: null, token: "3", task: null, obstacle: true, reason: "no element", ...over };
}

test("elements with a token are mapped, and stay in the list when they are no obstacle any more", () => {
  const found = [finding("weld"), finding("weld"), finding("check", { obstacle: false }), finding("bin", { token: null })];
  expect(elementsToMap(found, {})).toEqual(["weld"]);
  expect(elementsToMap([], { weld: "weld_2" })).toEqual(["weld"]);
});
