/** The last half minute of the five bends, in room that is taken once and never grows. */

const FINGERS = 5;

export class BendHistory {
  readonly #times: Float64Array;
  readonly #bends: Float64Array[];
  #count = 0;

  constructor(readonly seconds = 30, mostHz = 30) {
    const room = Math.ceil(seconds * mostHz);
    this.#times = new Float64Array(room);
    this.#bends = Array.from({ length: FINGERS }, () => new Float64Array(room));
  }

  /** Add what was seen at `atS`; what is older than the strip, or than its room, is dropped. */
  push(atS: number, bend: readonly number[]): void {
    let drop = 0;
    while (drop < this.#count && (this.#times[drop] ?? 0) < atS - this.seconds) drop++;
    if (this.#count - drop === this.#times.length) drop++;
    if (drop > 0) {
      for (const column of [this.#times, ...this.#bends]) column.copyWithin(0, drop, this.#count);
      this.#count -= drop;
    }
    this.#times[this.#count] = atS;
    this.#bends.forEach((column, finger) => {
      column[this.#count] = bend[finger] ?? NaN;
    });
    this.#count += 1;
  }

  /** Times, then the five bends: views of what is kept, for the plot. */
  columns(): Float64Array[] {
    return [this.#times, ...this.#bends].map((column) => column.subarray(0, this.#count));
  }
}
