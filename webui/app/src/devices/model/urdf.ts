/** The description of a robot for its 3D view, read from the text of a URDF. */
import type { JointDescription, RobotDescription } from "~/robot/description";

const MOVING = ["revolute", "continuous", "prismatic"];

/** The moving joints of a URDF in the order of the file; none if it is no XML. */
export function jointsIn(urdf: string): JointDescription[] {
  const file = new DOMParser().parseFromString(urdf, "application/xml");
  return [...file.querySelectorAll("robot > joint")]
    .filter((joint) => MOVING.includes(joint.getAttribute("type") ?? "") && joint.querySelector("mimic") === null)
    .map((joint) => {
      const type = joint.getAttribute("type") as JointDescription["type"];
      const limit = joint.querySelector("limit");
      const end = (name: string) => (type === "continuous" ? null : Number(limit?.getAttribute(name) ?? 0));
      return { name: joint.getAttribute("name") ?? "", type, unit: type === "prismatic" ? "m" : "rad", lower: end("lower"), upper: end("upper"), maxVelocity: Number(limit?.getAttribute("velocity") ?? 0), labels: {} };
    });
}

/** The view of a URDF at the origin, each joint at zero or at the middle of its range. */
export function viewOf(urdf: string): RobotDescription {
  const joints = jointsIn(urdf);
  return { model: "", revision: "", joints, home: joints.map(homeOf), tip: "", fingers: [], urdf, base: { position: [0, 0, 0], orientation: [0, 0, 0, 1] } };
}

function homeOf({ lower, upper }: JointDescription): number {
  if (lower === null || upper === null || (lower <= 0 && upper >= 0)) return 0;
  return (lower + upper) / 2;
}
