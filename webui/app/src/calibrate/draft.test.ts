import { describe, expect, it } from "vitest";
import { changesOf, moved, stateUnder, topOf, type Thresholds } from "./draft";

const saved: Thresholds = {
  thumb: { upper: 1000, lower: 800 },
  index: { upper: 1600, lower: 850 },
  middle: { upper: 1600, lower: 500 },
  ring: { upper: 1800, lower: 800 },
  little: { upper: 1900, lower: 900 },
};

describe("thresholds that are being changed", () => {
  it("move one at a time, in whole units", () => {
    const draft = moved(saved, "ring", "lower", 824.6);
    expect(draft.ring).toEqual({ upper: 1800, lower: 825 });
    expect(draft.thumb).toBe(saved.thumb);
    expect(saved.ring.lower).toBe(800);
  });

  it("never pass each other", () => {
    expect(moved(saved, "thumb", "upper", 100).thumb).toEqual({ upper: 800, lower: 800 });
    expect(moved(saved, "thumb", "lower", 5000).thumb).toEqual({ upper: 1000, lower: 1000 });
  });

  it("are sent to the controller only where they differ", () => {
    expect(changesOf(saved, saved)).toBeNull();
    expect(changesOf(saved, moved(saved, "ring", "lower", 825))).toEqual({ ring: { upper: 1800, lower: 825 } });
    expect(changesOf(saved, moved(moved(saved, "ring", "lower", 825), "ring", "lower", 800))).toBeNull();
  });

  it("say what a finger would be taken for, as the controller does at the very threshold", () => {
    expect([1001, 1000, 800, 799].map((bend) => stateUnder(saved.thumb, bend))).toEqual(["0", "1", "1", "2"]);
  });

  it("keep the direction of an inverted finger", () => {
    const inverted = { ...saved, ring: { upper: 1800, lower: 800, inverted: true } };
    expect([1801, 1800, 800, 799].map((bend) => stateUnder(inverted.ring, bend))).toEqual(["2", "1", "1", "0"]);
    expect(moved(inverted, "ring", "lower", 825).ring).toEqual({ upper: 1800, lower: 825, inverted: true });
  });

  it("leave room above the highest", () => {
    expect(topOf(saved)).toBe(2600);
  });
});
