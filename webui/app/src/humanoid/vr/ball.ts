/**
 * Where the ball is when a frame reaches the eyes: ballistic prediction from the newest places by the clock of the robot.
 *
 * With the known acceleration g, each place p at time t gives p + g (t0 - t)² / 2 = p0 - v (t0 - t), a straight line, whose
 * place and velocity come from least squares. Places that do not fit, after a bounce or a catch, are shown as they are.
 * Nothing is allocated for a place or a frame.
 */
import type { Vector } from "./frames";

export const GRAVITY_MPS2 = 9.81;
const KEPT = 6;
const LEAST = 3;
/** Of places from the line: a flight in simulation fits within a millimetre. */
const FITS_M = 0.02;
/** Farther ahead a prediction is a guess. */
export const MAX_AHEAD_S = 0.15;

export class BallPrediction {
  readonly #times = new Float64Array(KEPT);
  readonly #places = new Float64Array(3 * KEPT);
  readonly #fit = new Float64Array(6);
  #count = 0;
  #newest = -1;
  #isFitted = false;

  /** The time of the newest place, by the clock of the robot. */
  get newestS(): number {
    return this.#times[this.#newest] ?? NaN;
  }

  /** Forget the flight. */
  clear(): void {
    this.#count = 0;
    this.#newest = -1;
    this.#isFitted = false;
  }

  /** Take the place of the flying ball at `timeS` of the robot's clock; what is not newer or not finite is left out. */
  add(timeS: number, x: number, y: number, z: number): void {
    if (!Number.isFinite(timeS + x + y + z)) return;
    if (this.#count > 0) {
      const newest = this.#times[this.#newest] ?? 0;
      if (timeS <= newest) return;
      if (timeS - newest > 0.5) this.clear();
    }
    this.#newest = (this.#newest + 1) % KEPT;
    this.#count = Math.min(this.#count + 1, KEPT);
    this.#times[this.#newest] = timeS;
    this.#places.set([x, y, z], 3 * this.#newest);
    this.#isFitted = this.#count >= LEAST && this.#solve();
    // a bounce: what was before it says nothing about what follows
    if (this.#count >= LEAST && !this.#isFitted) this.#count = 1;
  }

  /** Write the place at `timeS` into `out`; returns false while no place is known. */
  at(timeS: number, out: Vector): boolean {
    if (this.#count === 0) return false;
    const base = 3 * this.#newest;
    const ahead = Math.min(Math.max(timeS - (this.#times[this.#newest] ?? 0), -MAX_AHEAD_S), MAX_AHEAD_S);
    if (this.#isFitted) {
      out.x = this.#value(0) + this.#value(3) * ahead;
      out.y = this.#value(1) + this.#value(4) * ahead;
      out.z = this.#value(2) + this.#value(5) * ahead - 0.5 * GRAVITY_MPS2 * ahead * ahead;
    } else {
      out.x = this.#places[base] ?? 0;
      out.y = this.#places[base + 1] ?? 0;
      out.z = this.#places[base + 2] ?? 0;
    }
    return true;
  }

  #value(index: number): number {
    return this.#fit[index] ?? 0;
  }

  /** Fit place and velocity at the newest time; returns whether all places are near the flight. */
  #solve(): boolean {
    const t0 = this.#times[this.#newest] ?? 0;
    let [sumT, sumTT] = [0, 0];
    for (let back = 0; back < this.#count; back += 1) {
      const t = (this.#times[this.#slot(back)] ?? 0) - t0;
      sumT += t;
      sumTT += t * t;
    }
    const n = this.#count;
    const determinant = n * sumTT - sumT * sumT;
    if (determinant <= 1e-12) return false;
    for (let axis = 0; axis < 3; axis += 1) {
      let [sumP, sumTP] = [0, 0];
      for (let back = 0; back < n; back += 1) {
        const t = (this.#times[this.#slot(back)] ?? 0) - t0;
        const p = this.#straight(back, axis, t);
        sumP += p;
        sumTP += t * p;
      }
      this.#fit[axis] = (sumTT * sumP - sumT * sumTP) / determinant;
      this.#fit[3 + axis] = (n * sumTP - sumT * sumP) / determinant;
      for (let back = 0; back < n; back += 1) {
        const t = (this.#times[this.#slot(back)] ?? 0) - t0;
        if (Math.abs(this.#straight(back, axis, t) - this.#value(axis) - this.#value(3 + axis) * t) > FITS_M) return false;
      }
    }
    return true;
  }

  #slot(back: number): number {
    return (this.#newest - back + KEPT) % KEPT;
  }

  /** A coordinate without the fall, which leaves a straight line. */
  #straight(back: number, axis: number, t: number): number {
    const p = this.#places[3 * this.#slot(back) + axis] ?? 0;
    return axis === 2 ? p + 0.5 * GRAVITY_MPS2 * t * t : p;
  }
}
