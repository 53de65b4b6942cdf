import { expect, it } from "vitest";
import { ringPart } from "./ring";

const held = (heldMs: number) => ({ heldMs, announceMs: 500, confirmMs: 1500 });

it("appears when the gesture is announced and closes when it counts", () => {
  expect(ringPart(held(0), 0)).toBe(0);
  expect(ringPart(held(499), 0)).toBe(0);
  expect(ringPart(held(1000), 0)).toBe(0.5);
  expect(ringPart(held(1500), 0)).toBe(1);
  expect(ringPart(held(4000), 0)).toBe(1);
});

it("goes on by the clock of the page, but not far beyond what was received", () => {
  expect(ringPart(held(1000), 50)).toBe(0.55);
  expect(ringPart(held(1000), 120)).toBe(ringPart(held(1000), 60_000));
  expect(ringPart(held(1000), -50)).toBe(0.5);
});

it("does not begin before anything is held", () => {
  expect(ringPart(held(0), 5000)).toBe(0);
});
