/** How long the way from a pose to the picture takes on our side, in ms. */
import { Durations, type Quantiles } from "./durations";

export const MEASURED = ["period", "work", "ownHands", "sent", "echo", "answered", "stateDrawn", "poseDrawn"] as const;
/**
 * period: between two frames. work: of the page for a frame. ownHands: from the pose of a frame to its drawn picture.
 * sent: from the pose to its message. echo: to the service and back. answered: from the pose to a state that has it.
 * stateDrawn: from a state to the drawn picture. poseDrawn: from a pose to the drawn picture of a state that has it.
 */
export type Measured = (typeof MEASURED)[number];

export class Measuring {
  readonly #durations = Object.fromEntries(MEASURED.map((name) => [name, new Durations()])) as Record<Measured, Durations>;
  #lastFrameMs: number | null = null;
  #sampledMs = 0;
  #receivedMs: number | null = null;
  #answeredPoseMs: number | null = null;
  #lastPoseMs = -Infinity;

  /** A frame begins: its poses are sampled. */
  begin(nowMs: number): void {
    if (this.#lastFrameMs !== null) this.add("period", nowMs - this.#lastFrameMs);
    this.#lastFrameMs = this.#sampledMs = nowMs;
  }

  sent(nowMs: number): void {
    this.add("sent", nowMs - this.#sampledMs);
  }

  /** A state came; `poseMs` is the time of the pose that it has, null without one. */
  received(nowMs: number, poseMs: number | null): void {
    this.#receivedMs ??= nowMs;
    if (poseMs === null || poseMs <= this.#lastPoseMs) return;
    this.#lastPoseMs = poseMs;
    this.#answeredPoseMs ??= poseMs;
    this.add("answered", nowMs - poseMs);
  }

  /** The page has done its part of a frame. */
  worked(nowMs: number): void {
    this.add("work", nowMs - this.#sampledMs);
  }

  /** A frame is drawn. */
  drawn(nowMs: number): void {
    this.add("ownHands", nowMs - this.#sampledMs);
    if (this.#receivedMs !== null) this.add("stateDrawn", nowMs - this.#receivedMs);
    if (this.#answeredPoseMs !== null) this.add("poseDrawn", nowMs - this.#answeredPoseMs);
    this.#receivedMs = this.#answeredPoseMs = null;
  }

  add(name: Measured, ms: number): void {
    this.#durations[name].add(ms);
  }

  clear(): void {
    for (const each of Object.values(this.#durations)) each.clear();
    this.#lastFrameMs = this.#receivedMs = this.#answeredPoseMs = null;
  }

  figures(): Record<Measured, Quantiles | null> {
    return Object.fromEntries(MEASURED.map((name) => [name, this.#durations[name].quantiles()])) as Record<Measured, Quantiles | null>;
  }
}
