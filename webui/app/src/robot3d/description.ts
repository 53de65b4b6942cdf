/** Robot descriptions: one small URDF a kind of robot, in `public/robots`, drawn with plain shapes. */
import type { Object3D } from "three";
import { LineSegments, Mesh } from "three";
import URDFLoader, { type URDFRobot } from "urdf-loader";

/** What stops the 3D view, so that the page can say it in words. */
export class NoDescription extends Error {
  constructor(readonly kind: string) {
    super(`there is no description of a robot of the kind ${kind}`);
    this.name = "NoDescription";
  }
}

/** The kind of robot that an id names: "ur10" for "ur10-1". */
export function kindOf(robot: string): string {
  return robot.replace(/-\d+$/, "");
}

/** Load the description of a kind of robot. Throws `NoDescription`. */
export async function describedRobot(kind: string, signal: AbortSignal): Promise<URDFRobot> {
  const answer = await fetch(`/robots/${encodeURIComponent(kind)}.urdf`, { signal });
  const text = answer.ok ? await answer.text() : "";
  // An unknown path is answered with the page itself.
  if (!text.includes("<robot")) throw new NoDescription(kind);
  return parsed(text);
}

/** The robot of a URDF text; its parts cast shadows. */
export function parsed(urdf: string): URDFRobot {
  const robot = new URDFLoader().parse(urdf);
  robot.traverse((part) => {
    if (part instanceof Mesh) part.castShadow = part.receiveShadow = true;
  });
  return robot;
}

/** Bend the joints by name (rad); joints that the description lacks are left out. */
export function bend(robot: URDFRobot, names: readonly string[], positions: readonly number[]): void {
  names.forEach((name, number) => {
    const angle = positions[number];
    if (angle !== undefined && name in robot.joints) robot.setJointValue(name, angle);
  });
}

const OPEN_M = 0.034;
const ROUND_A_PART_M = 0.015;

/** Open or close the fingers; they close round a part, or upon each other. */
export function grip(robot: URDFRobot, closed: boolean, holds: boolean): void {
  const way = closed ? (holds ? ROUND_A_PART_M : 0) : OPEN_M;
  for (const finger of ["finger_left_joint", "finger_right_joint"]) {
    if (finger in robot.joints) robot.setJointValue(finger, way);
  }
}

/** Give back what the graphics card keeps for `object` and all in it. */
export function release(object: Object3D): void {
  object.traverse((part) => {
    if (!(part instanceof Mesh || part instanceof LineSegments)) return;
    const { geometry, material } = part as Mesh;
    geometry.dispose();
    for (const one of Array.isArray(material) ? material : [material]) one.dispose();
  });
  object.removeFromParent();
}
