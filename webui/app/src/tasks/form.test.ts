import { describe, expect, it } from "vitest";
import { draftOf, entered, entryOf, inputs } from "./form";
import { field } from "./field";

const weight = field({ path: "part.weight", kind: "number", minimum: 0.5, maximum: 20, isRequired: true, decimals: 2 });
const colour = field({ path: "colour", kind: "choice", isRequired: true, options: [{ value: "r", label: "Red" }, { value: 2, label: "Green" }] });
const fields = [
  field({ path: "#1", kind: "group", fields: [weight] }),
  field({ path: "#2", kind: "note", label: "Read this" }),
  colour,
  field({ path: "count", kind: "integer", initial: 3 }),
  field({ path: "good", kind: "boolean" }),
  field({ path: "tags", kind: "choices", options: [{ value: "a", label: "A" }, { value: "b", label: "B" }] }),
  field({ path: "serial", kind: "text", pattern: "^[A-Z]\\d+$", maxLength: 5 }),
  field({ path: "pose", kind: "json" }),
];
const whole = { "part.weight": "1", colour: "0" };

describe("the form of a Task", () => {
  it("reads entries by kind into nested values, and sets nothing for empty ones", () => {
    expect(inputs(fields).map(({ path }) => path)).toEqual(["part.weight", "colour", "count", "good", "tags", "serial", "pose"]);
    expect(entered(fields, { ...whole, "part.weight": "2,5", colour: "1", tags: ["1"], pose: "[1, 2]" })).toEqual({
      values: { part: { weight: 2.5 }, colour: 2, count: 3, good: false, tags: ["b"], pose: [1, 2] },
      faults: {},
    });
  });

  it("names what does not fit, with the limit", () => {
    const faults = (draft: Record<string, string>) => entered(fields, { ...whole, ...draft }).faults;
    expect(entered(fields, {}).faults).toEqual({ "part.weight": { code: "required" }, colour: { code: "required" } });
    expect(faults({ "part.weight": "21" })).toEqual({ "part.weight": { code: "tooLarge", limit: 20 } });
    expect(faults({ "part.weight": "1.234" })).toEqual({ "part.weight": { code: "decimals", limit: 2 } });
    expect(faults({ "part.weight": "much", count: "1.5", serial: "7", pose: "[" })).toEqual({
      "part.weight": { code: "notANumber" }, count: { code: "notAnInteger" }, serial: { code: "pattern" }, pose: { code: "notJson" },
    });
    expect(faults({ serial: "A12345" })).toEqual({ serial: { code: "tooLong", limit: 5 } });
  });

  it("reads the items of a list, each with its faults", () => {
    const mm = field({ path: "mm", kind: "number", isRequired: true });
    const holes = field({ path: "holes", kind: "list", fields: [mm], initial: [{ mm: 3 }] });
    expect(entryOf(holes)).toEqual([{ mm: "3" }]);
    expect(entered([holes], { holes: [{ mm: "4" }, { mm: "" }] }).faults).toEqual({ "holes.1.mm": { code: "required" } });
    expect(entered([holes], {}).values).toEqual({ holes: [{ mm: 3 }] });
    const names = field({ path: "names", kind: "list", fields: [field({ path: "", kind: "text" })], initial: ["a"] });
    expect(entered([names], { names: [{ "": "a" }, { "": "b" }] }).values).toEqual({ names: ["a", "b"] });
    expect(draftOf([mm], null)).toEqual({ mm: "" });
  });

  it("keeps read-only values, and a date and a time as they are", () => {
    const serial = field({ path: "serial", kind: "text", isReadOnly: true, initial: "A7" });
    const day = field({ path: "day", kind: "date" });
    const moment = field({ path: "at", kind: "datetime" });
    const { values } = entered([serial, day, moment], { serial: "typed", day: "2026-03-02", at: "2026-03-02T08:00" });
    expect(values).toEqual({ serial: "A7", day: "2026-03-02", at: new Date("2026-03-02T08:00").toISOString() });
    expect(entryOf(moment, new Date("2026-03-02T08:00").toISOString())).toBe("2026-03-02T08:00");
  });

  it("leaves a pattern that the browser cannot read to the server", () => {
    expect(entered([field({ path: "a", kind: "text", pattern: "(?P<x>a)" })], { a: "b" }).faults).toEqual({});
  });
});
