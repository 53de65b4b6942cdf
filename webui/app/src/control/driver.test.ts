import { describe, expect, test } from "vitest";
import { SCAN_GAP_MS } from "~/shell/scans";
import { stoppedBy } from "./connection";
import { Driver, MAX_TOOL_MPS } from "./driver";
import { GAMEPAD } from "./mapping";

function driver(): Driver {
  const made = new Driver(() => [], () => 0);
  made.speed = 1;
  made.joints = [{ maxVelocity: 2 }, { maxVelocity: 1 }];
  made.position = [0, 0];
  return made;
}

test.each([
  [{ fault: null, limit: null, needsRelease: false }, false, "released"],
  [{ fault: null, limit: null, needsRelease: false }, true, "still"],
  [{ fault: null, limit: null, needsRelease: true }, true, "slow"],
  [{ fault: null, limit: "workspace", needsRelease: false }, true, "limit"],
  [{ fault: "no drive", limit: null, needsRelease: true }, true, "fault"],
] as const)("a motion that ends with %j while held is %s ended %s", (state, isHeld, why) => {
  expect(stoppedBy(state, isHeld)).toBe(why);
});

describe("the person", () => {
  test("moves the tool with the screen while the dead-man control is held", () => {
    const person = driver();
    person.push("z", 1);
    expect(person.input()).toMatchObject({ held: false, linear: [0, 0, MAX_TOOL_MPS] });
    person.hold(true);
    expect(person.input().held).toBe(true);
    person.hold(false);
    expect(person.input().held).toBe(false);
  });

  test("has to let everything go after the page lost the focus", () => {
    const pad = { connected: true, axes: [0, -1, 0, 0], buttons: Array.from({ length: 8 }, (_, index) => ({ pressed: index === GAMEPAD.buttons.hold })) };
    const pads: unknown[] = [pad];
    const person = new Driver(() => pads as Gamepad[]);
    expect(person.input().held).toBe(true);
    person.releaseAll();
    expect(person.input().held).toBe(false);
    expect(person.input().held).toBe(false);
    pads.length = 0;
    expect(person.input().held).toBe(false);
    pads.push(pad);
    expect(person.input().held).toBe(true);
  });

  test("jogs one joint, and goes to a preset without exceeding a joint's share of its speed", () => {
    const person = driver();
    person.pushJoint(1, -1);
    expect(person.input().joints).toEqual([0, -0.3]);
    person.pushJoint(1, 0);
    person.goTo([1, 0.001]);
    const joints = person.input().joints ?? [];
    expect(joints[0]).toBeCloseTo(0.6);
    expect(joints[1]).toBe(0);
    person.position = [1, 0];
    expect(person.input().joints).toEqual([0, 0]);
  });

  test("scales by the gamma of the device in use", () => {
    const person = driver();
    person.keyboard = { ...person.keyboard, gamma: 0.5 };
    person.keyDown("KeyW", -SCAN_GAP_MS);
    expect(person.input().gamma).toBe(0.5);
    person.keyUp("KeyW");
    person.push("x", 1);
    expect(person.input().gamma).toBe(1);
  });

  test("moves nothing by keys that are held no longer than a scanner holds them", () => {
    for (const code of ["Space", "KeyR", "KeyO"]) {
      let now = 0;
      const person = new Driver(() => [], () => now);
      person.keyDown(code, 0);
      now = SCAN_GAP_MS - 1;
      expect(person.input()).toMatchObject({ held: false, linear: [0, 0, 0], angular: [0, 0, 0] });
      expect(person.input().gripper).toBeUndefined();
      person.keyUp(code);
      now = 10 * SCAN_GAP_MS;
      expect(person.input()).toMatchObject({ held: false, linear: [0, 0, 0] });
    }
  });

  test("acts with the gripper once for each press", () => {
    const person = driver();
    person.keyDown("KeyO", -SCAN_GAP_MS);
    expect(person.input().gripper).toBe("open");
    expect(person.input().gripper).toBeUndefined();
    person.keyUp("KeyO");
    person.grip("close");
    expect(person.input().gripper).toBe("close");
    expect(person.input().gripper).toBeUndefined();
  });

  test("tilts the phone from where it was held, and moves nothing without the control", () => {
    const person = driver();
    person.sensor.tilt = { beta: 40, gamma: -10 };
    expect(person.input()).toMatchObject({ held: false, linear: [0, 0, 0] });
    person.hold(true);
    expect(person.input()).toMatchObject({ held: true, linear: [0, 0, 0] });
    person.sensor.tilt = { beta: 10, gamma: 30 };
    expect(person.input()).toMatchObject({ held: true, linear: [MAX_TOOL_MPS, -MAX_TOOL_MPS, 0] });
    expect(person.device).toBe("tilt");
    person.hold(false);
    expect(person.input()).toMatchObject({ held: false, linear: [0, 0, 0] });
    person.hold(true);
    expect(person.input().linear).toEqual([0, 0, 0]);
  });
});
