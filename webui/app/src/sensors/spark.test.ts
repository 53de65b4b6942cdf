import { expect, test } from "vitest";
import { sparkOf } from "./spark";

const points = (...list: [number, number][]) => list.map(([t, mean]) => ({ t, mean }));

test("a small chart fills its box, and is broken where values are missing", () => {
  expect(sparkOf(points([0, 5], [10, 10], [90, 0], [100, 5]), 0, 100, 20, 100, 20)).toEqual({ path: "M0 10L10 0M90 20L100 10", least: 0, most: 10 });
});

test("a constant value is drawn in the middle, and no value not at all", () => {
  expect(sparkOf(points([50, 7]), 0, 100, 20, 100, 20)?.path).toBe("M50 10");
  expect(sparkOf(points([500, 7]), 0, 100, 20, 100, 20)).toBeNull();
});
