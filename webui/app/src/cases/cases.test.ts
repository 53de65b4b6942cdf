import { describe, expect, it } from "vitest";
import type { HistoryView } from "~/api/generated/assistive-devices";
import { limitTone, linePath, panelsOf, stateOf, valueText, type Panel } from "./cases";

const history: HistoryView = { atS: [100, 101, 102], columns: { speed: [0, 0.5, 1], heartRate: [60, null, 80], vmax: [1.2, 1.2, 0.6] } };

function firstPath(panel: Panel | undefined, fromS: number, toS: number): string | null {
  const curve = panel?.curves[0];
  return panel === undefined || curve === undefined ? null : linePath(curve, panel, fromS, toS, 200, 100);
}

describe("the chart of a machine", () => {
  it("has speeds together, and the heart rate in a panel of its own that does not begin at 0", () => {
    const [speeds, heart] = panelsOf(history);
    expect(speeds?.curves.map(({ name }) => name)).toEqual(["speed", "vmax"]);
    expect([speeds?.low, speeds?.high, speeds?.unit]).toEqual([0, 1.2, "MTS"]);
    expect([heart?.low, heart?.high, heart?.curves[0]?.last]).toEqual([60, 80, 80]);
  });

  it("begins a new line after a gap", () => {
    expect(firstPath(panelsOf(history)[1], 100, 102)).toBe("M0.0 100.0M200.0 0.0");
  });

  it("draws a curve without values as nothing", () => {
    expect(firstPath(panelsOf({ atS: [1], columns: { period: [null] } })[0], 1, 1)).toBe("");
  });
});

it("shows values without a number as none, and no minus zero", () => {
  const vital = { name: "heartRate", quality: 1, status: "valid", ageS: 0, isCalibrated: true };
  expect(stateOf({ person: "p", vitals: [{ ...vital, value: null }, { ...vital, value: 70 }] }).values.map(({ value }) => value)).toEqual([70]);
  expect(valueText(-0.001, "MTS", "en")).toBe("0 m/s");
  expect(valueText(0.5, "P1", "en")).toBe("50%");
});

it("calls a limit of 0 a stop", () => {
  expect([0, 0.5, 1].map((fraction) => limitTone({ fraction, reason: "", needsReset: false }))).toEqual(["stop", "attention", "ok"]);
});
