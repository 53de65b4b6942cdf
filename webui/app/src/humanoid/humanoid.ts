/** The humanoid of the service whole-body control: its live document, its model, and places on its ground. */
import type { ModelView } from "~/api/generated/whole-body-control";

export const SERVICE = "whole-body-control";

export type Side = "left" | "right";
export const SIDES: readonly Side[] = ["left", "right"];
export type Pair = readonly [x: number, y: number];
export type Place = readonly [x: number, y: number, z: number];
export type Rotation = readonly [x: number, y: number, z: number, w: number];
/** Place and yaw of a sole on the ground, in m and rad. */
export type Footprint = readonly [x: number, y: number, yaw: number];

export interface FootState {
  /** Of the ground on the foot, in N. */
  force: Place | null;
  /** The centre of pressure on the ground, in m. */
  pressure: Pair | null;
  /** Of the weight, from 0 to 1. */
  share: number | null;
  /** Where the foot lands next, by the present plan; null for a foot that stays. Older recordings lack it. */
  landing?: Footprint | null;
}

export interface HandState {
  /** Of a person on the hand, in N. */
  force: Place | null;
  manipulability: number | null;
}

export interface BallState {
  position: Place | null;
  phase: "held" | "flying" | "landed" | "lost" | "caught" | "missed";
  target: Place | null;
  landing: Place | null;
}

export interface TaskState {
  /** The priority; 0 is the highest. */
  level: number;
  task: string;
  residual: number;
}

/** The headset and the hands of the person who exercises, on the ground of the robot. */
export interface PatientState {
  /** The time of the sender in s, of the pose that is shown. */
  t: number;
  headset: { position: Place; rotation: Rotation } | null;
  hands: Readonly<Record<Side, { position: Place; rotation: Rotation; grip: number } | null>>;
  tracking: "ok" | "lost";
  inBounds: boolean;
  /** Why no hand counts: a place that jumped, one out of the room, or too much force. */
  problem: "jump" | "far" | "force" | null;
}

export interface SessionState {
  id: string;
  application: "juggling" | "walking";
  state: "running" | "paused" | "ended";
  goal: { throws?: number; catches?: number; seconds?: number };
  progress: number;
  exercisedS: number;
  score: number;
  throws: number;
  caught: number;
  level: number;
  distanceM: number;
  /** Reasons with commas. */
  pauseReason: string;
  endedBy: string | null;
  /** When a ball counts as caught; null where none is thrown. */
  catch: { radiusM: number; needsGrip: boolean; closedGrip: number } | null;
}

/** What `/live` sends; null is what is not known. Places are in m on the ground of the robot, z is up. */
export interface LiveDocument {
  t: number | null;
  sentAt: number;
  humanoid: string;
  mode: "following" | "standing" | "holding" | "stopped" | "down" | null;
  behaviour: "standing" | "walking" | "assistedWalking" | "juggling";
  phase: "standing" | "double" | "single" | null;
  base: readonly number[] | null;
  joints: readonly (number | null)[];
  com: Pair | null;
  comReference: Pair | null;
  zmp: Pair | null;
  zmpReference: Pair | null;
  velocityReference: Pair | null;
  /** Between the soles: the frame of targets of throws. */
  stance: Footprint | null;
  feet: Readonly<Record<Side, FootState>>;
  hands: Readonly<Record<Side, HandState>>;
  /** The newest throw that was asked for; `preparing`: its hand rehearses in a simulation before it. */
  throw?: { number: number; hand: Side; target: Place; state: "planning" | "preparing" | "planned" | "refused"; reason: string } | null;
  ball: BallState | null;
  stack: readonly TaskState[];
  /** Constraints that contradict others: by how much each was relaxed at most in the last seconds, in m/s or rad/s. */
  relaxed?: readonly { constraint: string; slack: number }[];
  solver: { medianUs: number | null; p99Us: number | null; histogram: readonly (readonly [bound: number | null, count: number])[] };
  cycle: { count: number; late: number; lost: number; cause: string };
  /** The shares of the gains of the model that the joints have now, by chain. */
  gains?: Readonly<Record<string, { stiffness: number | null; damping: number | null }>>;
  limit: { factor: number; rule: string; reason: string; needsReset: boolean };
  stop: { isStopped: boolean; by: string; reason: string };
  needsRelease: boolean;
  patient?: PatientState | null;
  session: SessionState | null;
  fault: { code: string; message: string } | null;
}

export interface JointModel {
  name: string;
  lower: number;
  upper: number;
  velocity: number;
  effort: number;
  gain: number;
  damping: number;
}

export interface HumanoidModel extends ModelView {
  massKg: number;
  chains: (Record<string, unknown> & { name: string; base: string; tip: string; joints: JointModel[] })[];
  contacts: { name: string; link: string; corners: Place[]; friction: number }[];
  hands: Record<string, { arm: string; link: string; point: Place }>;
}

/** A place of the ground in the frame of `stance`. */
export function inFrame([x0, y0, yaw]: Footprint, [x, y, z]: Place): Place {
  const [dx, dy] = [x - x0, y - y0];
  return [Math.cos(yaw) * dx + Math.sin(yaw) * dy, Math.cos(yaw) * dy - Math.sin(yaw) * dx, z];
}

/** A place in the frame of `stance` on the ground. */
export function onGround([x0, y0, yaw]: Footprint, [x, y, z]: Place): Place {
  return [x0 + Math.cos(yaw) * x - Math.sin(yaw) * y, y0 + Math.sin(yaw) * x + Math.cos(yaw) * y, z];
}

/** The corners of a sole (in the frame of the foot) where its foot stands at `footprint`. */
export function soleAt(footprint: Footprint, corners: readonly Place[]): Pair[] {
  return corners.map((corner) => {
    const [x, y] = onGround(footprint, corner);
    return [x, y] as const;
  });
}

/** The convex hull of points on the ground, against the clock (Andrew's monotone chain). */
export function hullOf(points: readonly Pair[]): Pair[] {
  const sorted = [...points].sort((a, b) => a[0] - b[0] || a[1] - b[1]);
  if (sorted.length < 3) return sorted;
  const half = (ordered: readonly Pair[]) => {
    const chain: Pair[] = [];
    for (const point of ordered) {
      for (;;) {
        const [before, last] = chain.slice(-2);
        if (before === undefined || last === undefined || turn(before, last, point) > 0) break;
        chain.pop();
      }
      chain.push(point);
    }
    return chain.slice(0, -1);
  };
  return [...half(sorted), ...half(sorted.reverse())];
}

function turn([ax, ay]: Pair, [bx, by]: Pair, [cx, cy]: Pair): number {
  return (bx - ax) * (cy - ay) - (by - ay) * (cx - ax);
}

/** The feet that carry the robot: in single support the one with more of the weight. */
export function standingSides({ phase, feet }: Pick<LiveDocument, "phase" | "feet">): readonly Side[] {
  if (phase !== "single") return SIDES;
  return [(feet.left.share ?? 0) >= (feet.right.share ?? 0) ? "left" : "right"];
}

/** The corners of the support polygon, of the soles at these places; empty while they are not known. */
export function supportPolygon(document: Pick<LiveDocument, "phase" | "feet">, soles: Readonly<Partial<Record<Side, readonly Pair[]>>>): Pair[] {
  return hullOf(standingSides(document).flatMap((side) => soles[side] ?? []));
}

/** The ball as it is shown: what is left of a throw does not hang in the air while the robot walks. */
export function shownBall({ ball, behaviour }: Pick<LiveDocument, "ball" | "behaviour">): LiveDocument["ball"] {
  return behaviour === "juggling" || ball?.phase === "flying" ? ball : null;
}
