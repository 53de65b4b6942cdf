/** The description of a robot: joints with limits, home, gripper and URDF. */
import { useServiceQuery } from "~/api/useServiceQuery";
import { degrees, metres, shortMetres, wholeDegrees } from "./units";

/** A joint; limits are null for a continuous one. Units are rad and s, for a prismatic joint m and s. */
export interface JointDescription {
  name: string;
  type: "revolute" | "continuous" | "prismatic";
  unit: "rad" | "m";
  lower: number | null;
  upper: number | null;
  maxVelocity: number;
  /** Names for people, by language. */
  labels: Record<string, string>;
}

/** A joint of the gripper and its position in each state of the gripper. */
export interface FingerDescription {
  joint: string;
  opened: number;
  closed: number;
  holding: number;
}

/** `GET /robots/{robot}/description` of the trajectory tool, as far as it is shown. */
export interface RobotDescription {
  model: string;
  revision: string;
  joints: JointDescription[];
  home: number[];
  /** The link at which the gripper holds a part. */
  tip: string;
  fingers: FingerDescription[];
  urdf: string;
  /** Where the root link stands in the frame of the cell: m, and a quaternion (x, y, z, w). */
  base: { position: [number, number, number]; orientation: [number, number, number, number] };
}

export interface DescriptionQuery {
  description: RobotDescription | null;
  failure: string | null;
}

/** Load the description of a robot; another `revision` loads it again. */
export function useRobotDescription(robot: string, revision: string): DescriptionQuery {
  const path = `robots/${encodeURIComponent(robot)}/description`;
  const { value, failure } = useServiceQuery<RobotDescription>("trajectory-tool", path, { revision });
  return { description: value, failure };
}

/** The name of a joint for people. */
export function labelOf(joint: JointDescription, language: string): string {
  return joint.labels[language] ?? joint.labels["en"] ?? joint.name;
}

/** A position with its unit: "57.3 °" or "0.400 m". */
export function positionText(joint: JointDescription, position: number, language: string): string {
  return joint.unit === "m" ? `${metres(position, language)} m` : `${degrees(position, language)} °`;
}

export function speedText(joint: JointDescription, speed: number, language: string): string {
  return `${positionText(joint, speed, language)}/s`;
}

/** The range of a joint: "−170 … 170 °"; a continuous joint has none. */
export function rangeText(joint: JointDescription, language: string): string {
  if (joint.lower === null || joint.upper === null) return "∞";
  const [lower, upper] = [joint.lower, joint.upper].map((end) => (joint.unit === "m" ? shortMetres(end, language) : wholeDegrees(end, language)));
  return `${lower} … ${upper} ${joint.unit === "m" ? "m" : "°"}`;
}
