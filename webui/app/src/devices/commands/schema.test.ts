import { expect, test } from "vitest";
import type { CommandSpecification, Joint } from "~/api/generated/device-gateway";
import { draftOf } from "~/tasks/form";
import { commandFields, enteredParameters } from "./schema";

const command = (parameters: Record<string, unknown> | null): CommandSpecification => ({ name: "moveTo", kind: "motion", parameters });
const joints: Joint[] = [
  { name: "lift", type: "prismatic", lower: 0, upper: 0.5 },
  { name: "turn", type: "revolute", lower: -1, upper: 1 },
];
const moveTo = command({
  type: "object",
  required: ["joints"],
  properties: {
    joints: { type: "array", items: { type: "number" }, minItems: 2, maxItems: 2 },
    speed: { type: "number", minimum: 0, maximum: 1 },
    mode: { enum: ["slow", "fast"], default: "slow" },
    isSoft: { type: "boolean" },
  },
});

test("a number for each joint is named and limited like its joint", () => {
  const fields = commandFields(moveTo, joints);
  expect(fields.map(({ path, kind }) => [path, kind])).toEqual([["joints", "group"], ["speed", "number"], ["mode", "choice"], ["isSoft", "boolean"]]);
  expect(fields[0]?.fields.map(({ label, unit, minimum, maximum }) => [label, unit, minimum, maximum])).toEqual([["lift", "m", 0, 0.5], ["turn", "rad", -1, 1]]);
  expect(commandFields(moveTo, joints, { turn: { value: 0.123456 } })[0]?.fields.map(({ initial }) => initial)).toEqual([null, 0.1235]);
  const draft = { ...draftOf(fields, {}), "joints.0": "0.2", "joints.1": "-0,5" };
  expect(enteredParameters(fields, draft)).toEqual({ parameters: { joints: [0.2, -0.5], mode: "slow", isSoft: false }, faults: {} });
  expect(enteredParameters(fields, { ...draft, "joints.0": "2", "joints.1": "" }).faults).toEqual({ "joints.0": { code: "tooLarge", limit: 0.5 }, "joints.1": { code: "required" } });
});

test("a command without parameters has no form, and a schema that has none is entered as JSON", () => {
  expect(commandFields(command(null), joints)).toEqual([]);
  const fields = commandFields(command({ oneOf: [{ type: "object" }] }), joints);
  expect(enteredParameters(fields, { parameters: '{"a": [1]}' }).parameters).toEqual({ a: [1] });
  const nested = commandFields(command({ properties: { at: { type: "object" } } }), joints);
  expect(enteredParameters(nested, { at: '{"x": 1}' }).parameters).toEqual({ at: { x: 1 } });
});
