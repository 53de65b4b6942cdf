/** The delay of a control: what the robot needs, and what the network adds, over the last seconds. */

const KEPT_SENT = 256;
const KEPT_TRIPS = 100;
/** How long the course of the delay is kept, in seconds. */
export const KEPT_S = 30;
/** The highest value of the chart at least, in ms: so that a calm delay looks calm. */
const MIN_TOP_MS = 40;

export interface Latency {
  /** Median and maximum of the round trip without the time in the service, in ms. */
  networkMs: number | null;
  networkMaxMs: number | null;
}

export class RoundTrips {
  readonly #sent = new Map<number, number>();
  readonly #trips: number[] = [];
  #last = -1;

  send(seq: number, atMs: number): void {
    this.#sent.set(seq, atMs);
    for (const old of this.#sent.keys()) {
      if (this.#sent.size <= KEPT_SENT) break;
      this.#sent.delete(old);
    }
  }

  /**
   * A state has arrived that answers input `seq`; `ageMs` is how long ago the service had received that input.
   * Returns the round trip in ms, null for an input that was answered before.
   */
  receive(seq: number, ageMs: number, atMs: number): number | null {
    const sent = this.#sent.get(seq);
    if (sent === undefined || seq === this.#last) return null;
    this.#last = seq;
    const trip = Math.max(0, atMs - sent - ageMs);
    this.#trips.push(trip);
    if (this.#trips.length > KEPT_TRIPS) this.#trips.shift();
    return trip;
  }

  now(): Latency {
    if (this.#trips.length === 0) return { networkMs: null, networkMaxMs: null };
    const sorted = [...this.#trips].sort((a, b) => a - b);
    return { networkMs: sorted[sorted.length >> 1] ?? null, networkMaxMs: sorted.at(-1) ?? null };
  }
}

type Delay = readonly [atMs: number, networkMs: number | null, robotMs: number | null];

/** The course of both delays over the last `KEPT_S` seconds. */
export class DelayHistory {
  #delays: Delay[] = [];

  /** Times must not decrease. */
  push(atMs: number, networkMs: number | null, robotMs: number | null): void {
    this.#delays.push([atMs, networkMs, robotMs]);
    const first = this.#delays.findIndex(([at]) => at >= atMs - KEPT_S * 1000);
    if (first > 0) this.#delays.splice(0, first);
  }

  /** The times in seconds before `nowMs`, which are negative, and both delays in ms. */
  columns(nowMs: number): [number[], (number | null)[], (number | null)[]] {
    const shown = this.#delays.filter(([at]) => at >= nowMs - KEPT_S * 1000);
    return [shown.map(([at]) => (at - nowMs) / 1000), shown.map(([, network]) => network), shown.map(([, , robot]) => robot)];
  }
}

/** The top of a scale whose largest value is `mostMs`: 4, 10 or 20 times a power of ten, so that it seldom changes. */
export function topOf(mostMs: number | null): number {
  const most = Math.max(mostMs ?? 0, MIN_TOP_MS);
  const power = 10 ** Math.floor(Math.log10(most / 2));
  return [2, 4, 10, 20].map((step) => step * power).find((top) => top >= most) ?? most;
}
