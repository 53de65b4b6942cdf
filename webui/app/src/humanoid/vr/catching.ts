/**
 * How near the ball comes to a palm, as the service counts it: between two samples both move in a straight line. The
 * service alone decides what is caught; the page shows the reach of the palm, and how near the ball came.
 */
import type { Vector } from "./frames";

/** The smallest distance of two points on the way from `before` to `after`, given as their differences (ball - palm). */
export function closest(before: Readonly<Vector>, after: Readonly<Vector>): number {
  const [wayX, wayY, wayZ] = [after.x - before.x, after.y - before.y, after.z - before.z];
  const squared = wayX * wayX + wayY * wayY + wayZ * wayZ;
  const share = squared > 0 ? Math.min(Math.max(-(before.x * wayX + before.y * wayY + before.z * wayZ) / squared, 0), 1) : 1;
  return Math.hypot(before.x + share * wayX, before.y + share * wayY, before.z + share * wayZ);
}

/** Notices when a flying ball first comes within the reach of a palm, so that a contact is felt without a delay. */
export class Contact {
  readonly #before: Vector = { x: 0, y: 0, z: 0 };
  readonly #apart: Vector = { x: 0, y: 0, z: 0 };
  #isFollowed = false;
  #isTouched = false;

  /** Take the ball and the palm of a frame, null where one is not there; returns whether the contact begins. */
  update(ball: Readonly<Vector> | null, palm: Readonly<Vector> | null, reachM: number): boolean {
    if (ball === null) this.#isTouched = false;
    if (ball === null || palm === null) {
      this.#isFollowed = false;
      return false;
    }
    this.#apart.x = ball.x - palm.x;
    this.#apart.y = ball.y - palm.y;
    this.#apart.z = ball.z - palm.z;
    const isNear = closest(this.#isFollowed ? this.#before : this.#apart, this.#apart) <= reachM;
    Object.assign(this.#before, this.#apart);
    this.#isFollowed = true;
    const begins = isNear && !this.#isTouched;
    this.#isTouched ||= isNear;
    return begins;
  }
}
