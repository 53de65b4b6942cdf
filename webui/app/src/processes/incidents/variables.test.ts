import { describe, expect, it } from "vitest";
import { editedVariables, variablesText } from "./variables";

const before = { part: "bolt", count: 2, pose: { x: 1, y: [1, 2] } };

describe("edited variables", () => {
  it("are those that differ, whatever the order of their members", () => {
    expect(editedVariables(variablesText(before), before)).toEqual({ values: {} });
    expect(editedVariables('{"count": 3, "part": "bolt", "pose": {"y": [1, 2], "x": 1}, "new": null}', before)).toEqual({
      values: { count: 3, new: null },
    });
    expect(editedVariables('{"pose": {"x": 1, "y": [2, 1]}}', { pose: before.pose })).toEqual({ values: { pose: { x: 1, y: [2, 1] } } });
    expect(editedVariables('{"a": {}}', { a: [] })).toEqual({ values: { a: {} } });
  });

  it("are none in an empty text", () => {
    expect(editedVariables("  ", {})).toEqual({ values: {} });
  });

  it("have to be a JSON object, and the line of an error is known", () => {
    expect(editedVariables('{\n  "a": 1,\n  b: 2\n}', {})).toEqual({ fault: "syntax", line: 3 });
    expect(editedVariables('{\n  "a": 1', {})).toMatchObject({ fault: "syntax", line: 2 });
    for (const text of ["[]", "3", "null", '"a"']) expect(editedVariables(text, {})).toEqual({ fault: "notAnObject" });
  });

  it("have names that expressions can use", () => {
    expect(editedVariables('{"part_1": 1}', {})).toEqual({ values: { part_1: 1 } });
    expect(editedVariables('{"größe": 1}', {})).toEqual({ fault: "name", name: "größe" });
    expect(editedVariables('{"größe": 2}', { "größe": 1 })).toEqual({ values: { "größe": 2 } });
    expect(editedVariables('{"part name": 1}', {})).toEqual({ fault: "name", name: "part name" });
    expect(editedVariables('{"1st": 1}', {})).toEqual({ fault: "name", name: "1st" });
  });

  it("cannot lose a variable", () => {
    expect(editedVariables('{"part": "bolt", "count": 2}', before)).toEqual({ fault: "removed", name: "pose" });
  });
});
