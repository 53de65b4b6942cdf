/** A person without a headset: the pointer moves one hand at a depth in front of fixed eyes, keys do the rest. */
import { PerspectiveCamera, Quaternion, Vector2, Vector3 } from "three";
import type { Side } from "../humanoid";
import { SEAT_M, SEATED_EYES_M } from "./frames";
import type { TrackedHand } from "./hands";

const DEPTHS_M = { least: 0.2, most: 0.9, start: 0.4 };
const DEPTH_STEP_M = 0.02;
const KEY_STEP = 0.04;
/** So that the panel and the feet of the robot are in the picture. */
const LOOKS_AT = new Vector3(0, 0.8, 0);

export class Pointer {
  readonly camera = new PerspectiveCamera(70, 1, 0.05, 40);
  readonly at = new Vector2();
  side: Side = "right";
  depthM = DEPTHS_M.start;
  isPressed = false;
  /** Whether the pointer is in the picture, or was moved by keys. */
  isThere = false;
  readonly #ahead = new Vector3();
  readonly #place = new Vector3();
  readonly #turn = new Quaternion();

  constructor() {
    this.camera.position.set(SEAT_M, SEATED_EYES_M, 0);
    this.camera.lookAt(LOOKS_AT);
    this.camera.updateMatrixWorld(true);
  }

  moveTo(x: number, y: number): void {
    this.at.set(Math.min(Math.max(x, -1), 1), Math.min(Math.max(y, -1), 1));
    this.isThere = true;
  }

  deeper(steps: number): void {
    this.depthM = Math.min(Math.max(this.depthM + steps * DEPTH_STEP_M, DEPTHS_M.least), DEPTHS_M.most);
  }

  /** Handle a key; returns whether it moved the hand. None has a character, so that nothing typed moves it. */
  key(key: string): boolean {
    const steps: Readonly<Record<string, readonly [number, number]>> = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const step = steps[key];
    if (step !== undefined) this.moveTo(this.at.x + step[0] * KEY_STEP, this.at.y + step[1] * KEY_STEP);
    else if (key === "PageUp" || key === "PageDown") this.deeper(key === "PageUp" ? 1 : -1);
    else if (key === " ") this.isPressed = true;
    else if (key === "Home" || key === "End") this.side = key === "Home" ? "left" : "right";
    else return false;
    return true;
  }

  /** Put the hands where the pointer is; the other hand is not tracked. */
  place(hands: Readonly<Record<Side, TrackedHand>>): void {
    hands[this.side === "left" ? "right" : "left"].lose();
    if (!this.isThere) {
      hands[this.side].lose();
      return;
    }
    this.camera.getWorldDirection(this.#ahead);
    this.#place.set(this.at.x, this.at.y, 0.5).unproject(this.camera).sub(this.camera.position).normalize();
    const depth = this.depthM / Math.max(this.#place.dot(this.#ahead), 0.1);
    this.#place.multiplyScalar(depth).add(this.camera.position);
    this.#turn.copy(this.camera.quaternion);
    hands[this.side].put(this.#place, this.#turn, this.isPressed ? 1 : 0);
  }
}
