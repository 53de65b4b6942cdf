import { describe, expect, it } from "vitest";
import { shapeOf } from "./geometry";
import expected from "./shapes.fixture.json";

describe("the hand of the page and of the pictures", () => {
  it.each(expected)("has its joints in the same places when bent by $bends", ({ bends, points, folded }) => {
    const phalanges = shapeOf(bends).map((shape) => shape.phalanges);
    const seen = phalanges.flat().map(({ from, to }) => [...from, ...to]);
    seen.forEach((ends, index) => ends.forEach((value, end) => expect(value).toBeCloseTo(points[index]?.[end] ?? Number.NaN, 2)));
    expect(phalanges.map((finger) => finger.map((phalanx) => phalanx.folded))).toEqual(folded);
  });
});
