import { expect, test } from "vitest";
import type { DeviceDescription } from "~/api/generated/device-gateway";
import { draftOfDescription, enteredDescription, fieldsOf, hasJoints } from "./description";

const UNITS = { CEL: "°C", C62: "" };
const arm: DeviceDescription = {
  kind: "robotArm",
  title: "Arm",
  degreesOfFreedom: 2,
  joints: [
    { name: "a", type: "revolute", lower: -1, upper: 1, maxVelocity: 2, maxAcceleration: 3 },
    { name: "b", type: "continuous" },
  ],
  gripper: { type: "parallel", maxWidth: 0.08 },
  skills: ["move", "pick"],
  sensors: [{ name: "temperature", unit: "CEL", minimum: -20, maximum: 60, deadBand: 0.2 }],
  commands: [{ name: "moveTo", kind: "motion", parameters: { type: "object" } }],
  placement: { location: "hall", relativePosition: [1, 0, 0.5], coordinates: [23.1, 65] },
};

function form(description: DeviceDescription) {
  const fields = fieldsOf((key) => key, UNITS, description.kind);
  return { fields, draft: draftOfDescription(fields, description) };
}

test("a description comes out of the form as it went in", () => {
  const { fields, draft } = form(arm);
  expect(enteredDescription(fields, draft, arm)).toEqual({ description: arm, faults: {} });
});

test("a sensor has no joints, and an empty form asks for what is required", () => {
  expect([hasJoints("robotArm"), hasJoints("gripper"), hasJoints("sensor"), hasJoints("")]).toEqual([true, true, false, false]);
  const { fields, draft } = form({ kind: "sensor" });
  expect(Object.keys(draft)).not.toContain("joints");
  const { faults } = enteredDescription(fields, { ...draft, kind: "", sensors: [{ name: "" }] }, null);
  expect(Object.keys(faults).sort()).toEqual(["kind", "sensors.0.name"]);
});

test("half of a place or of a gripper is named", () => {
  const { fields, draft } = form({ ...arm, gripper: null });
  const { faults, description } = enteredDescription(fields, { ...draft, "placement.latitude": "", "placement.y": "", "gripper.maxForce": "70" }, arm);
  expect(faults).toEqual({ "placement.latitude": { code: "required" }, "gripper.type": { code: "required" } });
  expect(description.placement?.relativePosition).toEqual([1, 0, 0.5]);
});
