/** How far ahead of the start of a frame its picture is seen. */

const START_MS = 1000 / 72;
const MOST_MS = 100;
/** A frame that took longer than usual says little about the next one. */
const SHARE = 0.1;

export class Horizon {
  #periodMs = START_MS;
  #drawnMs: number | null = null;
  #saidMs: number | null = null;

  /** The time from the start of a frame until it is seen: what the headset says, else what was measured, and a period at least. */
  get ms(): number {
    return this.#saidMs ?? Math.max(this.#drawnMs ?? 0, this.#periodMs);
  }

  /** A frame begins, `periodMs` after the last; `displayMs` is when the headset shows it, where it says so. */
  begin(nowMs: number, periodMs: number, displayMs: number | undefined): void {
    if (periodMs > 0 && periodMs < MOST_MS) this.#periodMs += SHARE * (periodMs - this.#periodMs);
    const aheadMs = (displayMs ?? NaN) - nowMs;
    // an emulator says the start of the frame
    this.#saidMs = aheadMs > 1 && aheadMs < MOST_MS ? aheadMs : null;
  }

  /** The picture of a frame was drawn so long after its start. */
  drawn(ms: number): void {
    const least = Math.min(Math.max(ms, 0), MOST_MS);
    this.#drawnMs = this.#drawnMs === null ? least : this.#drawnMs + SHARE * (least - this.#drawnMs);
  }
}
