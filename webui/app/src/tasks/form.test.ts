import { describe, expect, it } from "vitest";
import { entered, entryOf, fieldsOf } from "./form";

const form = {
  type: "object",
  properties: {
    weight: { type: "number", title: "Weight in kg", minimum: 0.5, maximum: 20 },
    count: { type: "integer", default: 3 },
    good: { type: "boolean" },
    colour: { oneOf: [{ const: "r", title: "Red" }, { const: "g", title: "Green" }] },
    size: { enum: [1, 2] },
    serial: { type: "string", pattern: "^[A-Z]\\d+$", maxLength: 5 },
    pose: { type: "array" },
  },
  required: ["weight", "colour"],
};
const fields = fieldsOf(form, { serial: "A7" });
const read = (typed: Record<string, string>) => entered(form, fields, { weight: "1", colour: "0", ...typed });

describe("the form of a Task", () => {
  it("has a field of each property, with its title, choices and first value", () => {
    expect(fields.map(({ title, kind, isRequired }) => [title, kind, isRequired])).toEqual([
      ["Weight in kg", "number", true],
      ["count", "integer", false],
      ["good", "boolean", false],
      ["colour", "choice", true],
      ["size", "choice", false],
      ["serial", "text", false],
      ["pose", "json", false],
    ]);
    expect(fields.map((field) => entryOf(field))).toEqual(["", "3", "false", "", "", "A7", ""]);
    expect(fieldsOf(null)).toEqual([]);
  });

  it("reads entries by type, and sets nothing for empty ones", () => {
    expect(read({ weight: "2,5", size: "1", pose: "[1, 2]", serial: "" })).toEqual({
      values: { weight: 2.5, count: 3, good: false, colour: "r", size: 2, pose: [1, 2] },
      faults: {},
    });
  });

  it("names what does not fit", () => {
    expect(entered(form, fields, {}).faults).toEqual({ weight: "required", colour: "required" });
    expect(read({ weight: "0.1", count: "1.5", serial: "7", pose: "[" }).faults).toEqual({
      weight: "tooSmall", count: "notAnInteger", serial: "pattern", pose: "notJson",
    });
    expect(read({ weight: "21", count: "many", serial: "A12345" }).faults).toEqual({ weight: "tooLarge", count: "notANumber", serial: "tooLong" });
  });

  it("leaves a pattern that the browser cannot read to the server", () => {
    const odd = { properties: { a: { type: "string", pattern: "(?P<x>a)" } } };
    expect(entered(odd, fieldsOf(odd), { a: "b" }).faults).toEqual({});
  });
});
