/** The last 30 s of the five bends, in a buffer of fixed size. */

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

  /** Add the bends at `atS`; values that are too old, or exceed the buffer, are dropped. */
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

  /** Times, then the five bends: views of the buffer, for the plot. */
  columns(): Float64Array[] {
    return [this.#times, ...this.#bends].map((column) => column.subarray(0, this.#count));
  }
}
