import { describe, expect, it } from "vitest";
import { ago, clockTime, duration, rate } from "./times";

describe("times as people say them", () => {
  it.each([
    [0, "0 s ago"],
    [12_900, "12 s ago"],
    [61_000, "1 min ago"],
    [3 * 3600_000, "3 h ago"],
    [50 * 3600_000, "2 d ago"],
    [-5000, "0 s ago"],
  ])("%i ms before now is %s", (before, text) => {
    expect(ago(1e12 - before, 1e12, "en")).toBe(text);
  });

  it.each([
    [850, "850 ms"],
    [2500, "2.5 s"],
    [185_000, "3 min 05 s"],
    [4_320_000, "1 h 12 min"],
  ])("%i ms last %s", (ms, text) => {
    expect(duration(ms, "en")).toBe(text);
  });

  it("is a time without a date only in the last day, or later today", () => {
    const now = new Date(2026, 4, 4, 14, 0).getTime();
    const at = (day: number, hour: number) => clockTime(new Date(2026, 4, day, hour, 3).toISOString(), "en-GB", now);
    expect([at(4, 9), at(3, 15), at(4, 16)]).toEqual(["09:03", "15:03", "16:03"]);
    expect(at(5, 8)).toContain("5 May 2026");
    expect(at(2, 8)).toContain("2 May 2026");
  });

  it("is said in the order of the language", () => {
    expect(ago(0, 12_000, "de")).toBe("vor 12 s");
    expect(ago(0, 2 * 86_400_000, "fi")).toBe("2 vrk sitten");
  });

  it("has the comma of the language", () => {
    expect(duration(2500, "de")).toBe("2,5 s");
    expect(rate(3.25, "fi")).toBe("3,3 /s");
  });
});
