/**
* Joint states arrive at most 30 times a second, a screen draws 60 times: positions between are interpolated.
* A new state is reached in the interval since the previous one, so that the drawing never overtakes the robot.
 */

const MIN_DURATION_MS = 16;
const MAX_DURATION_MS = 300;
/** Smaller changes of a joint are not visible. */
const SAME_RAD = 1e-5;

export class JointTrack {
  #from: number[] = [];
  #to: number[] = [];
  #startMs = 0;
  #lastMs = 0;
  #durationMs = MIN_DURATION_MS;

  /** Add the joints (rad) received at `nowMs`; returns whether they changed. */
  push(positions: readonly number[], nowMs: number): boolean {
    const sinceMs = nowMs - this.#lastMs;
    this.#lastMs = nowMs;
    if (this.#to.length !== positions.length) {
      this.#from = [...positions];
      this.#to = [...positions];
      this.#durationMs = MIN_DURATION_MS;
      return true;
    }
    if (positions.every((angle, joint) => Math.abs(angle - (this.#to[joint] ?? 0)) < SAME_RAD)) return false;
    this.#from = this.at(nowMs);
    this.#to = [...positions];
    this.#startMs = nowMs;
    this.#durationMs = Math.min(Math.max(sinceMs, MIN_DURATION_MS), MAX_DURATION_MS);
    return true;
  }

  /** The joints to draw at `nowMs`; empty while none have been received. */
  at(nowMs: number): number[] {
    const part = Math.min(Math.max((nowMs - this.#startMs) / this.#durationMs, 0), 1);
    return this.#to.map((angle, joint) => {
      const from = this.#from[joint] ?? angle;
      return from + (angle - from) * part;
    });
  }

  /** Whether the interpolation continues after `nowMs`. */
  glides(nowMs: number): boolean {
    return nowMs < this.#startMs + this.#durationMs;
  }
}
