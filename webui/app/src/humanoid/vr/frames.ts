/**
 * Places of virtual reality and of the ground of the robot.
 *
 * three.js and WebXR have y up and look along -z; the ground has z up, and x ahead of the robot at its start. The
 * `anchor` is the place of the robot on the ground that stays in the middle of the scene: when the robot walks with a
 * person, the scene keeps it in front of them instead of moving them, which would make many people sick.
 */
import type { Footprint } from "../humanoid";

/** Of three.js, which is written in place: nothing is allocated for a frame. */
export interface Vector {
  x: number;
  y: number;
  z: number;
}

export interface Turn extends Vector {
  w: number;
}

/** Where the head of the patient is when they start: in front of the robot, with the hands where balls arrive. */
export const SEAT_M = 1.15;
/** Of a seated person, where the headset does not know the ground. */
export const SEATED_EYES_M = 1.15;

/** Write the place on the ground of a place of the scene into `out`. */
export function toGround([x0, y0, yaw]: Footprint, scene: Readonly<Vector>, out: Vector): void {
  const [ahead, left, up] = [scene.x, -scene.z, scene.y];
  out.x = x0 + Math.cos(yaw) * ahead - Math.sin(yaw) * left;
  out.y = y0 + Math.sin(yaw) * ahead + Math.cos(yaw) * left;
  out.z = up;
}

/** Write the place in the scene of a place on the ground into `out`. */
export function toScene([x0, y0, yaw]: Footprint, x: number, y: number, z: number, out: Vector): void {
  const [dx, dy] = [x - x0, y - y0];
  out.x = Math.cos(yaw) * dx + Math.sin(yaw) * dy;
  out.z = Math.sin(yaw) * dx - Math.cos(yaw) * dy;
  out.y = z;
}

/**
 * Write the rotation on the ground of something that looks along -z with y up in the scene into `out`: on the ground it
 * looks along its x axis with z up, as the robot does.
 */
export function turnToGround(anchorYaw: number, scene: Readonly<Turn>, out: Turn): void {
  // from the axes of the scene to those of the ground: a quarter turn about x, then the yaw of the anchor about z
  const [cosine, sine] = [Math.cos(anchorYaw / 2) * Math.SQRT1_2, Math.sin(anchorYaw / 2) * Math.SQRT1_2];
  const [ax, ay, az, aw] = [cosine, sine, sine, cosine];
  const { x: bx, y: by, z: bz, w: bw } = scene;
  const x = aw * bx + ax * bw + ay * bz - az * by;
  const y = aw * by - ax * bz + ay * bw + az * bx;
  const z = aw * bz + ax * by - ay * bx + az * bw;
  const w = aw * bw - ax * bx - ay * by - az * bz;
  // the axes of a head: its x axis is -z of WebXR, its y axis is -x, its z axis is y
  out.x = 0.5 * (-w + x + y - z);
  out.y = 0.5 * (w - x + y - z);
  out.z = 0.5 * (w + x + y + z);
  out.w = 0.5 * (w + x - y - z);
}

/** How far a head is turned about the vertical, in rad; null while it looks nearly straight up or down. */
export function yawOf({ x, y, z, w }: Readonly<Turn>): number | null {
  const ahead = [-2 * (x * z + w * y), -(1 - 2 * (x * x + y * y))] as const;
  return Math.hypot(...ahead) < 0.3 ? null : Math.atan2(-ahead[0], -ahead[1]);
}

/** The origin of a reference space: its place in the space of the headset, and its turn about the vertical. */
export interface Origin extends Vector {
  yaw: number;
}

/**
 * The origin that puts a head at the seat, looking at the robot. Where the headset knows the ground the height is kept,
 * so that the robot stands on the real ground at its real size. Null while the head looks up or down, or its pose is no
 * finite number.
 */
export function recentred(head: Readonly<Vector>, turn: Readonly<Turn>, knowsGround: boolean): Origin | null {
  const yaw = yawOf(turn);
  if (yaw === null || ![head.x, head.y, head.z, yaw].every(Number.isFinite)) return null;
  // the robot is along -x of the scene from the seat, which is a quarter turn to the left
  const back = yaw - Math.PI / 2;
  return {
    x: head.x - SEAT_M * Math.cos(back),
    y: knowsGround ? 0 : head.y - SEATED_EYES_M,
    z: head.z + SEAT_M * Math.sin(back),
    yaw: back,
  };
}
