// @vitest-environment jsdom
import { readFileSync } from "node:fs";
import { Matrix4, Quaternion, Vector3 } from "three";
import { describe, expect, test } from "vitest";
import { bend, boxesOf, grip, InvalidDescription, parsed, release } from "./urdf";
import known from "./ur10.poses.json";

const urdf = readFileSync("../../services/trajectory_tool/handover_robots/robots/ur10/ur10.urdf", "utf8")
const fingers = ["left", "right"].map((side) => ({ joint: `finger_${side}_joint`, opened: 0.034, closed: 0, holding: 0.015 }));;

/** The position of the gripper's tip for joint angles in rad, in the frame of the base. */
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
    grip(robot, fingers, false, false);
    const open = between();
    grip(robot, fingers, true, true);
    const round = between();
    grip(robot, fingers, true, false);
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
});

describe("the description of any robot", () => {
  const robotOf = (links: string) => parsed(`<robot name="any">${links}</robot>`);
  const joint = (name: string, type: string, parent: string, child: string, xyz: string, axis: string) =>
    `<joint name="${name}" type="${type}"><parent link="${parent}"/><child link="${child}"/><origin xyz="${xyz}"/>
    <axis xyz="${axis}"/><limit lower="0" upper="1" velocity="1" effort="1"/></joint>`;
  const chain = joint("slide", "prismatic", "base", "carriage", "0 0 0.5", "0 1 0") + joint("turn", "continuous", "carriage", "arm", "0 0 1", "0 0 1");

  test("has prismatic and continuous joints", () => {
    const robot = robotOf(`<link name="base"/><link name="carriage"/><link name="arm"/>${chain}`);
    bend(robot, ["slide", "turn", "none"], [0.75, 9, 1]);
    robot.updateMatrixWorld(true);
    const arm = new Vector3().setFromMatrixPosition(robot.links["arm"]?.matrixWorld ?? new Matrix4());
    expect(arm.toArray()).toEqual([0, 0.75, 1.5]);
    expect(robot.joints["turn"]?.angle).toBe(9);
  });

  test("is drawn as rods where it has no shapes, or only mesh files", () => {
    const mesh = '<visual><geometry><mesh filename="package://arm/base.dae"/></geometry></visual>';
    const robot = robotOf(`<link name="base">${mesh}</link><link name="carriage"/><link name="arm"/>${chain}`);
    const { robot: box } = boxesOf(robot, ["slide"], [0]);
    expect(box.max.z).toBeGreaterThan(1.5);
    expect(box.min.z).toBeLessThan(0.01);
  });

  test("is drawn as its collision shapes where it has no others", () => {
    const shape = (kind: string, size: string) => `<${kind}><geometry><box size="${size}"/></geometry></${kind}>`;
    const only = robotOf(`<link name="base">${shape("collision", "2 2 2")}</link>`);
    expect(boxesOf(only, [], []).root.max.x).toBe(1);
    const both = robotOf(`<link name="base">${shape("visual", "1 1 1")}${shape("collision", "2 2 2")}</link>`);
    expect(boxesOf(both, [], []).root.max.x).toBe(0.5);
  });

  test("is refused if it is no URDF", () => {
    expect(() => parsed("")).toThrow(InvalidDescription);
  });
});
