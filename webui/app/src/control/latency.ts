/** The latency of a control: what the robot needs, and what the network adds, over the last seconds. */

const KEPT_SENT = 256;
const KEPT_TRIPS = 100;

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

  /** A state has arrived that answers input `seq`; `ageMs` is how long ago the service had received that input. */
  receive(seq: number, ageMs: number, atMs: number): void {
    const sent = this.#sent.get(seq);
    if (sent === undefined || seq === this.#last) return;
    this.#last = seq;
    this.#trips.push(Math.max(0, atMs - sent - ageMs));
    if (this.#trips.length > KEPT_TRIPS) this.#trips.shift();
  }

  now(): Latency {
    if (this.#trips.length === 0) return { networkMs: null, networkMaxMs: null };
    const sorted = [...this.#trips].sort((a, b) => a - b);
    return { networkMs: sorted[sorted.length >> 1] ?? null, networkMaxMs: sorted.at(-1) ?? null };
  }
}
