/** The last durations of one kind in ms: median and 99 % of them, without an allocation for one that is added. */
const KEPT = 600;

export interface Quantiles {
  count: number;
  median: number;
  p99: number;
}

export class Durations {
  readonly #values = new Float64Array(KEPT);
  #count = 0;

  add(ms: number): void {
    if (!(ms >= 0)) return;
    this.#values[this.#count % KEPT] = ms;
    this.#count += 1;
  }

  clear(): void {
    this.#count = 0;
  }

  /** Null without values. */
  quantiles(): Quantiles | null {
    const count = Math.min(this.#count, KEPT);
    if (count === 0) return null;
    const sorted = this.#values.slice(0, count).sort();
    const at = (share: number) => sorted[Math.min(Math.ceil(share * count), count) - 1] ?? 0;
    return { count, median: at(0.5), p99: at(0.99) };
  }
}
