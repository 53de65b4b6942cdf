import { expect, test } from "vitest";
import { jointsOf, robotsOf } from "./robots";

test("registered robots that are connected can be controlled beside those of the trajectory tool", () => {
  const devices = [
    { name: "nao-1", kind: "humanoid", connected: true },
    { name: "cobot-1", kind: "robotArm", connected: false },
    { name: "hall-1", kind: "sensor", connected: true },
    { name: "ur10-1", kind: "robotArm", connected: true },
  ];
  expect(robotsOf(["ur10-1"], devices)).toEqual([
    { service: "trajectory-tool", name: "ur10-1" },
    { service: "device-gateway", name: "nao-1" },
  ]);
});

test("joints of a registered robot are shown with their limits and units", () => {
  const joints = jointsOf({ description: { kind: "robotArm", joints: [{ name: "rail", type: "prismatic", lower: 0, upper: 1 }, { name: "turn", type: "continuous", maxVelocity: 2 }] } });
  expect(joints).toMatchObject([
    { name: "rail", unit: "m", lower: 0, upper: 1 },
    { name: "turn", unit: "rad", lower: null, maxVelocity: 2 },
  ]);
  expect(jointsOf(null)).toEqual([]);
});
