/** A phone or tablet that is tilted: its orientation moves the tool, or the base, while the control is held. */
import { atRest, type Motion } from "./mapping";

/** Angles of `DeviceOrientationEvent` in degrees: forwards and backwards, and to the sides. */
export interface Tilt {
  beta: number;
  gamma: number;
}

export const TILT = { gamma: 1 };
const DEAD_DEG = 3;
/** Tilted by so much more, the motion has the whole chosen speed. */
const FULL_DEG = 25;
const FIRST_EVENT_MS = 3000;

type Asking = typeof DeviceOrientationEvent & { requestPermission?: () => Promise<PermissionState> };

/** What a tilt asks for, compared with that at which the control was held: nothing jumps when it begins. */
export function ofTilt(now: Tilt, from: Tilt): Motion {
  const motion = atRest();
  motion.axes.x = amount(turned(from.beta, now.beta));
  motion.axes.y = amount(turned(from.gamma, now.gamma));
  return motion;
}

/** The way from one angle to another, from -180 to 180 degrees. */
function turned(to: number, from: number): number {
  return ((to - from + 540) % 360) - 180;
}

function amount(degrees: number): number {
  const beyond = Math.max(0, Math.abs(degrees) - DEAD_DEG) / FULL_DEG;
  return beyond === 0 ? 0 : Math.sign(degrees) * Math.min(1, beyond);
}

/** The orientation of this device, once `start` was called by an act of the person. */
export class TiltSensor {
  tilt: Tilt | null = null;
  #listens = false;

  /** Ask for the permission that some browsers demand, and for a first event; return whether one came. */
  async start(): Promise<boolean> {
    if (typeof DeviceOrientationEvent === "undefined") return false;
    const asking = DeviceOrientationEvent as Asking;
    if (asking.requestPermission !== undefined && (await asking.requestPermission()) !== "granted") return false;
    if (!this.#listens) addEventListener("deviceorientation", this.#take);
    this.#listens = true;
    const ends = performance.now() + FIRST_EVENT_MS;
    while (this.tilt === null && performance.now() < ends) await new Promise((resolve) => setTimeout(resolve, 50));
    if (this.tilt === null) this.stop();
    return this.tilt !== null;
  }

  stop(): void {
    removeEventListener("deviceorientation", this.#take);
    this.#listens = false;
    this.tilt = null;
  }

  readonly #take = ({ beta, gamma }: DeviceOrientationEvent): void => {
    // A computer without such a sensor sends one event with nothing in it.
    if (beta !== null && gamma !== null) this.tilt = { beta, gamma };
  };
}
