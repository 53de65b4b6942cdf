import { describe, expect, it } from "vitest";
import { CAP_HEIGHT, DEFAULT_STATION, defaultStation, HAND_HELD, minFontPx, pxOf } from "./station";

const fullHd = { width: 1920, height: 1080 };

describe("the station", () => {
  it("needs 34 px of cap height for 16 minutes of arc at 2 m on a 24-inch full HD screen", () => {
    expect(pxOf(16, DEFAULT_STATION, fullHd)).toBeCloseTo(33.6, 1);
    expect(minFontPx(DEFAULT_STATION, fullHd)).toBeCloseTo(33.6 / CAP_HEIGHT, 0);
  });

  it("needs the same height in millimetres whatever the resolution: at 4K twice the pixels", () => {
    const twice = { width: 3840, height: 2160 };
    expect(minFontPx(DEFAULT_STATION, twice)).toBeCloseTo(2 * minFontPx(DEFAULT_STATION, fullHd), 6);
  });

  it("needs larger type from further away and smaller type on a larger screen", () => {
    const size = (diagonalIn: number, distanceM: number) => minFontPx({ diagonalIn, distanceM }, fullHd);
    expect(size(24, 4)).toBeCloseTo(2 * size(24, 2), 6);
    expect(size(48, 2)).toBeCloseTo(size(24, 2) / 2, 6);
  });

  it("takes a phone for held in the hand, and anything larger for a screen on the wall", () => {
    expect(defaultStation({ width: 390, height: 844 })).toBe(HAND_HELD);
    expect(defaultStation({ width: 844, height: 390 })).toBe(HAND_HELD);
    expect(defaultStation({ width: 820, height: 1180 })).toBe(DEFAULT_STATION);
  });
});
