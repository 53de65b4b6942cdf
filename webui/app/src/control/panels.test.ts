import { expect, test } from "vitest";
import { isArrangement, moved, ordered, PANELS, STANDARD, withShown } from "./panels";

test("a user moves, hides and shows panels; each panel stays there once", () => {
  const first = moved(STANDARD, "jog", -1);
  expect(ordered(first).slice(0, 2)).toEqual(["jog", "view"]);
  const hidden = withShown(first, "view", false);
  expect(ordered(moved(hidden, "joints", -1)).filter((one) => one !== "view").slice(0, 2)).toEqual(["joints", "jog"]);
  expect(withShown(hidden, "view", true).hidden).toEqual([]);
  expect(moved(STANDARD, "latency", 1)).toEqual(STANDARD);
  expect([...ordered(hidden)].sort()).toEqual([...PANELS].sort());
});

test("an arrangement of an older page keeps its order, and new panels come last", () => {
  expect(ordered({ order: ["latency", "jog"], hidden: [] }).slice(0, 3)).toEqual(["latency", "jog", "view"]);
  expect(isArrangement({ order: ["view"], hidden: [] })).toBe(true);
  expect(isArrangement({ order: ["nothing"], hidden: [] })).toBe(false);
  expect(isArrangement({})).toBe(false);
});
