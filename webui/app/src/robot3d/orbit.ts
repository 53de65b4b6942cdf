/** Turning the view with keys: the camera's position after a step around its target (z is up, metres). */

export type Point = readonly [x: number, y: number, z: number];

export interface Step {
  /** Around the vertical to the right, rad. */
  right?: number;
  /** Upwards, rad. */
  up?: number;
  /** Factor of the distance: below 1 is nearer. */
  distance?: number;
}

/** The limits of the camera's distance, in reaches of the robot. */
export interface Distances {
  least: number;
  most: number;
}

export const DISTANCES: Distances = { least: 0.6, most: 6 };
/** The limits of the polar angle: not vertical, and not from below the ground. */
const LOWEST_RAD = -0.08;
const HIGHEST_RAD = Math.PI / 2 - 0.05;

const TURN_RAD = Math.PI / 24;

/** The step of a key; null for other keys. */
export function stepOf(key: string): Step | "reset" | null {
  switch (key) {
    case "ArrowLeft":
      return { right: -TURN_RAD };
    case "ArrowRight":
      return { right: TURN_RAD };
    case "ArrowUp":
      return { up: TURN_RAD };
    case "ArrowDown":
      return { up: -TURN_RAD };
    case "+":
    case "=":
      return { distance: 1 / 1.15 };
    case "-":
      return { distance: 1.15 };
    case "0":
    case "Home":
      return "reset";
    default:
      return null;
  }
}

export function stepped(camera: Point, target: Point, { right = 0, up = 0, distance = 1 }: Step, { least, most }: Distances = DISTANCES): Point {
  const [x, y, z] = [camera[0] - target[0], camera[1] - target[1], camera[2] - target[2]];
  const away = Math.hypot(x, y, z);
  const reached = clamp(away * distance, least, most);
  const azimuth = Math.atan2(y, x) + right;
  const height = clamp(Math.asin(clamp(z / away, -1, 1)) + up, LOWEST_RAD, HIGHEST_RAD);
  return [
    target[0] + reached * Math.cos(height) * Math.cos(azimuth),
    target[1] + reached * Math.cos(height) * Math.sin(azimuth),
    target[2] + reached * Math.sin(height),
  ];
}

function clamp(value: number, least: number, most: number): number {
  return Math.min(Math.max(value, least), most);
}
