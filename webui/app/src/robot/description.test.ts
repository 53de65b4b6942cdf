import { describe, expect, test } from "vitest";
import { type JointDescription, labelOf, positionText, rangeText, speedText } from "./description";

const elbow: JointDescription = {
  name: "elbow", type: "revolute", unit: "rad", lower: -Math.PI, upper: Math.PI / 2, maxVelocity: 1, labels: { en: "Elbow", de: "Ellbogen" },
};
const rail: JointDescription = { name: "rail", type: "prismatic", unit: "m", lower: 0, upper: 1.6, maxVelocity: 1, labels: {} };

describe("a joint", () => {
  test("has its name in the language of the page, else in English, else its own", () => {
    expect(labelOf(elbow, "de")).toBe("Ellbogen");
    expect(labelOf(elbow, "fi")).toBe("Elbow");
    expect(labelOf(rail, "fi")).toBe("rail");
  });

  test("that turns is shown in degrees, one that slides in metres", () => {
    expect(positionText(elbow, -1, "en")).toBe("−57.3 °");
    expect(positionText(rail, 0.4, "de")).toBe("0,400 m");
    expect(speedText(rail, -0.25, "en")).toBe("−0.250 m/s");
  });

  test("has a range unless it turns without end", () => {
    expect(rangeText(elbow, "en")).toBe("−180 … 90 °");
    expect(rangeText(rail, "en")).toBe("0 … 1.6 m");
    expect(rangeText({ ...elbow, type: "continuous", lower: null, upper: null }, "en")).toBe("∞");
  });
});
