// @vitest-environment jsdom
import { readFileSync } from "node:fs";
import { Matrix4, Quaternion, Vector3 } from "three";
import { describe, expect, test } from "vitest";
import { bend, grip, kindOf, parsed, release } from "./description";
import known from "./ur10.poses.json";

const urdf = readFileSync("public/robots/ur10.urdf", "utf8");

/** Where the tip of the gripper is for joint angles in rad, seen from the base. */
function tipOf(joints: number[]): { position: Vector3; orientation: Quaternion } {
  const robot = parsed(urdf);
  bend(robot, known.joint_names, joints);
  robot.updateMatrixWorld(true);
  const tip = robot.links["tip"];
  if (tip === undefined) throw new Error("the description has no tip");
  const [position, orientation] = [new Vector3(), new Quaternion()];
  new Matrix4().copy(tip.matrixWorld).decompose(position, orientation, new Vector3());
  return { position, orientation };
}

describe("the UR10's description", () => {
  test.each(known.poses)("has its tip where the trajectory tool has it: $name", ({ joints, position, orientation }) => {
    const tip = tipOf(joints);
    expect(tip.position.distanceTo(new Vector3(...position))).toBeLessThan(1e-5);
    expect(tip.orientation.angleTo(new Quaternion(...orientation).normalize())).toBeLessThan(1e-5);
  });

  test("has the joints that the trajectory tool names, and each turns fully either way", () => {
    const robot = parsed(urdf);
    for (const name of known.joint_names) {
      expect(robot.joints[name]?.limit).toMatchObject({ lower: -2 * Math.PI, upper: 2 * Math.PI });
    }
  });

  test("is drawn with plain shapes alone: nothing else has to be fetched", () => {
    expect(urdf).not.toContain("<mesh");
  });

  test("closes its fingers round a part, and upon each other without one", () => {
    const robot = parsed(urdf);
    const between = (): number => {
      robot.updateMatrixWorld(true);
      const [left, right] = ["finger_left", "finger_right"].map((name) => new Vector3().setFromMatrixPosition(
        robot.links[name]?.matrixWorld ?? new Matrix4(),
      ));
      return left?.distanceTo(right ?? left) ?? NaN;
    };
    grip(robot, false, false);
    const open = between();
    grip(robot, true, true);
    const round = between();
    grip(robot, true, false);
    expect(open).toBeGreaterThan(round);
    expect(round).toBeCloseTo(0.03);
    expect(between()).toBe(0);
  });

  test("gives back all that the graphics card keeps", () => {
    const robot = parsed(urdf);
    const kept = new Set<unknown>();
    robot.traverse((part) => {
      const geometry = (part as { geometry?: { addEventListener(name: "dispose", then: () => void): void } }).geometry;
      if (geometry === undefined) return;
      kept.add(geometry);
      geometry.addEventListener("dispose", () => kept.delete(geometry));
    });
    expect(kept.size).toBeGreaterThan(30);
    release(robot);
    expect(kept.size).toBe(0);
  });

  test("is found by the robot's id", () => {
    expect(kindOf("ur10-1")).toBe("ur10");
    expect(kindOf("arm")).toBe("arm");
  });
});
