import { expect, test } from "vitest";
import { degrees, metres } from "./units";

test("angles are shown in degrees with one digit, in the language of the page", () => {
  expect(degrees(-Math.PI / 2, "en")).toBe("−90.0");
  expect(degrees(1, "de")).toBe("57,3");
});

test("a joint at rest does not flicker between 0 and -0", () => {
  expect(degrees(-0.0001, "en")).toBe("0.0");
  expect(degrees(0.0001, "en")).toBe("0.0");
});

test("lengths are shown in millimetres", () => {
  expect(metres(-0.16394, "en")).toBe("−0.164");
  expect(metres(-0.0001, "fi")).toBe("0,000");
});
