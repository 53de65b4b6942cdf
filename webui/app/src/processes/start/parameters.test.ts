import { describe, expect, it } from "vitest";
import { filledIn, initialText, kindOf, parameterIn, type Parameter } from "./parameters";

const parameter = (name: string, standard: unknown, required = false): Parameter => ({ name, required, default: standard });
const all = [
  parameter("robot", "Device:ur10-1"),
  parameter("speed", 0.5),
  parameter("careful", true),
  parameter("pose", [0, 1.5, { deep: null }]),
  parameter("order", null, true),
];

it("asks for what the default is", () => {
  expect(all.map(kindOf)).toEqual(["text", "number", "boolean", "json", "text"]);
  expect(all.map(initialText)).toEqual(["Device:ur10-1", "0.5", "true", '[0,1.5,{"deep":null}]', ""]);
});

describe("what was typed", () => {
  it("is read by its kind, and defaults stay as they are", () => {
    const { values, faults } = filledIn(all, { speed: " 1,25 ", careful: "false", order: "66" });
    expect(faults).toEqual({});
    expect(values).toEqual({ robot: "Device:ur10-1", speed: 1.25, careful: false, pose: [0, 1.5, { deep: null }], order: "66" });
  });

  it("is refused field by field", () => {
    const { faults } = filledIn(all, { speed: "fast", pose: "[1, 2" });
    expect(faults).toEqual({ speed: "notANumber", pose: "notJson", order: "required" });
  });

  it("can empty a text, and leaves a number that was emptied to its default", () => {
    expect(filledIn(all, { robot: "", speed: "", order: "1" }).values).toEqual({ robot: "", careful: true, pose: [0, 1.5, { deep: null }], order: "1" });
  });
});

it("finds the field that a refusal speaks of", () => {
  expect(parameterIn('bin-picking cannot start without "order"', all)).toBe("order");
  expect(parameterIn('"robot" and "order" do not go together', all)).toBeNull();
  expect(parameterIn("the broker is away", all)).toBeNull();
});
