/**
 * A recording as a source of live documents. Frames are fetched in parts as the replay comes near them, and kept; the
 * picture and the panels show them as they show the robot.
 */
import type { FramesView } from "~/api/generated/whole-body-control";
import type { LiveDocument } from "./humanoid";

/** How much is fetched before it is shown, in s. */
const AHEAD_S = 5;

export interface ReplaySnapshot {
  phase: "connecting" | "open" | "lost";
  document: LiveDocument | null;
  positionS: number;
  durationS: number;
  isPlaying: boolean;
}

/** Returns the frames from a time in s on, and where the rest begins. */
export type Frames = (fromS: number) => Promise<FramesView>;

export class Replay {
  #snapshot: ReplaySnapshot = { phase: "connecting", document: null, positionS: 0, durationS: 0, isPlaying: true };
  #frames: FramesView["frames"] = [];
  #knownS = 0;
  #hasAll = false;
  #isFetching = false;
  #shownMs: number | null = null;
  #request: number | null = null;
  readonly #listeners = new Set<() => void>();
  readonly #fetch: Frames;
  readonly #onFailure: (error: unknown) => void;

  constructor(fetch: Frames, onFailure: (error: unknown) => void) {
    this.#fetch = fetch;
    this.#onFailure = onFailure;
  }

  /** Plays while somebody listens. */
  readonly subscribe = (listener: () => void): (() => void) => {
    this.#listeners.add(listener);
    this.#run();
    return () => {
      this.#listeners.delete(listener);
      if (this.#listeners.size > 0 || this.#request === null) return;
      cancelAnimationFrame(this.#request);
      this.#request = null;
    };
  };

  readonly snapshot = (): ReplaySnapshot => this.#snapshot;

  play(isPlaying: boolean): void {
    const { positionS, durationS } = this.#snapshot;
    this.#show({ isPlaying, positionS: isPlaying && this.#hasAll && positionS >= durationS ? 0 : positionS });
    this.#run();
  }

  seek(positionS: number): void {
    this.#show({ positionS });
    this.#run();
  }

  /** Advances by the time since the last call; a test calls it with times of its own. */
  readonly advance = (nowMs: number): void => {
    const { isPlaying, positionS, durationS, phase } = this.#snapshot;
    const passedS = this.#shownMs === null ? 0 : (nowMs - this.#shownMs) / 1000;
    this.#shownMs = nowMs;
    if (this.#needsMore) this.#fetchMore();
    if (!isPlaying || phase !== "open") return;
    const end = this.#hasAll ? durationS : this.#knownS;
    const next = Math.min(positionS + passedS, end);
    const isOver = this.#hasAll && next >= durationS;
    if (next !== positionS || isOver) this.#show({ positionS: next, isPlaying: !isOver });
  };

  /** Advance with the frames of the screen while somebody listens, and it plays or fetches. */
  #run(): void {
    if (this.#request !== null || this.#listeners.size === 0) return;
    this.#shownMs = null; // a pause takes no time of the recording
    this.#request = requestAnimationFrame(this.#tick);
  }

  readonly #tick = (nowMs: number): void => {
    this.advance(nowMs);
    const continues = this.#listeners.size > 0 && (this.#snapshot.isPlaying || this.#needsMore);
    this.#request = continues ? requestAnimationFrame(this.#tick) : null;
  };

  get #needsMore(): boolean {
    return !this.#hasAll && this.#snapshot.positionS + AHEAD_S >= this.#knownS;
  }

  #fetchMore(): void {
    if (this.#isFetching) return;
    this.#isFetching = true;
    this.#fetch(this.#knownS)
      .then(({ frames, durationS, nextFrom }) => {
        this.#frames.push(...frames);
        // The service answers with a span; after the last one there is nothing more.
        const knownS = nextFrom ?? (frames.at(-1)?.t ?? this.#knownS) + 1e-6;
        this.#hasAll = frames.length === 0 || knownS >= durationS;
        this.#knownS = Math.max(knownS, this.#knownS);
        this.#show({ phase: "open", durationS });
      })
      .catch((error: unknown) => {
        this.#hasAll = true;
        this.#onFailure(error);
        this.#show({ phase: "lost" });
      })
      .finally(() => {
        this.#isFetching = false;
      });
  }

  #show(change: Partial<ReplaySnapshot>): void {
    const next = { ...this.#snapshot, ...change };
    this.#snapshot = { ...next, document: frameAt(this.#frames, next.positionS) ?? next.document };
    for (const listener of this.#listeners) listener();
  }
}

/** Returns the last document at or before a time in s, of frames in their order. */
export function frameAt(frames: FramesView["frames"], atS: number): LiveDocument | null {
  let low = 0;
  let high = frames.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if ((frames[middle]?.t ?? Infinity) <= atS) low = middle + 1;
    else high = middle;
  }
  return (frames[Math.max(low - 1, 0)]?.document ?? null) as LiveDocument | null;
}
