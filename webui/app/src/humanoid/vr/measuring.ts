/** How long the way from a pose to the picture takes on our side, in ms. */
import { Durations, type Quantiles } from "./durations";

export const MEASURED = ["period", "work", "drawing", "ownHands", "sent", "echo", "answered", "poseWorked", "stateDrawn", "poseDrawn", "ballAge", "ball"] as const;
/**
 * period: between two frames. work: of the page for a frame. drawing: from the end of the work to the drawn picture.
 * ownHands: from the pose of a frame to its drawn picture. sent: from the pose to its message. echo: to the service and back.
 * answered: from the pose to a state that has it. poseWorked: from a pose to the end of the work for the first frame that
 * shows a state with it, which is all but the drawing. stateDrawn: from a state to the drawn picture. poseDrawn: from a pose to the
 * drawn picture of a state that has it. ballAge: of the newest known place of the flying ball when it is drawn. ball: what of
 * that the prediction does not make up for.
 */
export type Measured = (typeof MEASURED)[number];

/** A picture on its way: the times of what it shows, by `performance.now()`. */
export interface Picture {
  readonly sampledMs: number;
  readonly workedMs: number;
  readonly receivedMs: number | null;
  readonly poseMs: number | null;
  readonly ball: { readonly shownMs: number; readonly newestMs: number } | null;
}

export class Measuring {
  readonly #durations = Object.fromEntries(MEASURED.map((name) => [name, new Durations()])) as Record<Measured, Durations>;
  #lastFrameMs: number | null = null;
  #sampledMs = 0;
  #receivedMs: number | null = null;
  #answeredPoseMs: number | null = null;
  /** The first pose that a state of this frame has, drawn or not. */
  #framePoseMs: number | null = null;
  /** How long drawing commands take, which frames lack that are not drawn in software. */
  #commandsMs = 0;
  #lastPoseMs = -Infinity;
  #ball: Picture["ball"] = null;

  /** A frame begins: its poses are sampled. */
  begin(nowMs: number): void {
    if (this.#lastFrameMs !== null) this.add("period", nowMs - this.#lastFrameMs);
    this.#lastFrameMs = this.#sampledMs = nowMs;
    this.#ball = null;
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
    this.#framePoseMs ??= poseMs;
    this.add("answered", nowMs - poseMs);
  }

  /** The frame shows the ball where it is at `shownMs`; its newest known place is of `newestMs`. */
  showsBall(shownMs: number, newestMs: number): void {
    this.#ball = { shownMs, newestMs };
  }

  /**
   * The page has done its part of a frame, at last the drawing commands since `drawsMs`; returns what its picture shows,
   * null for a frame that is not drawn. That one counts with the usual time of the commands.
   */
  worked(nowMs: number, drawsMs: number, isDrawn: boolean): Picture | null {
    if (isDrawn) this.#commandsMs += (this.#commandsMs === 0 ? 1 : 0.1) * (nowMs - drawsMs - this.#commandsMs);
    if (this.#framePoseMs !== null) this.add("poseWorked", (isDrawn ? nowMs : drawsMs + this.#commandsMs) - this.#framePoseMs);
    this.#framePoseMs = null;
    if (!isDrawn) return null;
    const picture = { sampledMs: this.#sampledMs, workedMs: nowMs, receivedMs: this.#receivedMs, poseMs: this.#answeredPoseMs, ball: this.#ball };
    this.add("work", nowMs - picture.sampledMs);
    this.#receivedMs = this.#answeredPoseMs = null;
    return picture;
  }

  /** A picture is drawn. */
  drawn(picture: Picture, nowMs: number): void {
    this.add("drawing", nowMs - picture.workedMs);
    this.add("ownHands", nowMs - picture.sampledMs);
    if (picture.receivedMs !== null) this.add("stateDrawn", nowMs - picture.receivedMs);
    if (picture.poseMs !== null) this.add("poseDrawn", nowMs - picture.poseMs);
    if (picture.ball === null) return;
    this.add("ballAge", nowMs - picture.ball.newestMs);
    this.add("ball", Math.abs(nowMs - picture.ball.shownMs));
  }

  add(name: Measured, ms: number): void {
    this.#durations[name].add(ms);
  }

  clear(): void {
    for (const each of Object.values(this.#durations)) each.clear();
    this.#lastFrameMs = this.#receivedMs = this.#answeredPoseMs = this.#framePoseMs = null;
  }

  figures(): Record<Measured, Quantiles | null> {
    return Object.fromEntries(MEASURED.map((name) => [name, this.#durations[name].quantiles()])) as Record<Measured, Quantiles | null>;
  }
}
