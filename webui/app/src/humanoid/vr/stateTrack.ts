/**
 * The last states of the robot, from which each frame of the headset gets a state in between. All memory is allocated
 * at the start; what a document lacks keeps its last value.
 */
import type { LiveDocument } from "../humanoid";

const KEPT = 32;
export const BASE = 7;
const DEFAULT_PERIOD_S = 1 / 30;

export class StateTrack {
  /** The base (x, y, z, qx, qy, qz, qw), then the joints in rad. */
  readonly values: Float64Array;
  readonly #states: Float64Array;
  readonly #times = new Float64Array(KEPT);
  readonly #width: number;
  #newest = -1;
  #count = 0;
  #periodS = DEFAULT_PERIOD_S;

  constructor(joints: number) {
    this.#width = BASE + joints;
    this.values = new Float64Array(this.#width);
    this.values[6] = 1;
    this.#states = new Float64Array(KEPT * this.#width);
  }

  get isKnown(): boolean {
    return this.#count > 0;
  }

  /** The time between two states, in s: so far behind a frame is drawn that it lies between two. */
  get periodS(): number {
    return this.#periodS;
  }

  /** Take a document; returns whether it is newer than the last. */
  push({ t, base, joints }: Pick<LiveDocument, "t" | "base" | "joints">): boolean {
    if (t === null || base?.length !== BASE) return false;
    const last = this.#count > 0 ? (this.#times[this.#newest] ?? 0) : -Infinity;
    if (t === last) return false;
    if (t < last) this.#count = 0; // the robot was started again
    else if (t - last < 0.5) this.#periodS += 0.1 * (t - last - this.#periodS);
    const before = this.#newest;
    this.#newest = (this.#newest + 1) % KEPT;
    const start = this.#newest * this.#width;
    for (let index = 0; index < this.#width; index += 1) {
      const value = index < BASE ? base[index] : joints[index - BASE];
      const kept = before < 0 ? 0 : (this.#states[before * this.#width + index] ?? 0);
      this.#states[start + index] = value ?? kept;
    }
    this.#times[this.#newest] = t;
    this.#count = Math.min(this.#count + 1, KEPT);
    return true;
  }

  /** Write the state at the time `t` of the robot into `values`; outside of what is known the nearest one. */
  sample(t: number): void {
    if (this.#count === 0) return;
    let later = this.#newest;
    let earlier = later;
    for (let back = 0; back < this.#count; back += 1) {
      earlier = (this.#newest - back + KEPT) % KEPT;
      if ((this.#times[earlier] ?? 0) <= t) break;
      later = earlier;
    }
    const [from, to] = [this.#times[earlier] ?? 0, this.#times[later] ?? 0];
    this.#mix(earlier * this.#width, later * this.#width, to > from ? Math.min(Math.max((t - from) / (to - from), 0), 1) : 1);
  }

  #mix(earlier: number, later: number, share: number): void {
    const states = this.#states;
    let dot = 0;
    for (let index = 3; index < BASE; index += 1) dot += (states[earlier + index] ?? 0) * (states[later + index] ?? 0);
    for (let index = 0; index < this.#width; index += 1) {
      const isTurn = index >= 3 && index < BASE;
      const to = (states[later + index] ?? 0) * (isTurn && dot < 0 ? -1 : 1);
      const from = states[earlier + index] ?? 0;
      this.values[index] = from + share * (to - from);
    }
    let size = 0;
    for (let index = 3; index < BASE; index += 1) size += (this.values[index] ?? 0) ** 2;
    const scale = size > 0 ? 1 / Math.sqrt(size) : 0;
    for (let index = 3; index < BASE; index += 1) this.values[index] = (this.values[index] ?? 0) * scale;
    if (size === 0) this.values[6] = 1;
  }
}
