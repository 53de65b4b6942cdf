/** Pulses that the page gives by itself, without a way to the service: a throw, a contact, a pause, leaving the bounds. */
import { SIDES, type LiveDocument, type Side } from "../humanoid";
import { Contact } from "./catching";
import type { Vector } from "./frames";

const WARNING = [0.6, 200] as const;
const CONTACT = [0.3, 30] as const;
const THROWN = [0.25, 40] as const;
/** Outside of the bounds a pulse comes so often. */
const WARN_EVERY_MS = 1000;

export interface FeltHand {
  isTracked: boolean;
  position: Readonly<Vector>;
  pulse: (intensity: number, ms: number) => void;
}

export class Haptics {
  readonly #hands: Readonly<Record<Side, FeltHand>>;
  readonly #contacts: Record<Side, Contact> = { left: new Contact(), right: new Contact() };
  #wasPaused = false;
  #wasFlying = false;
  #warnedMs = -Infinity;

  constructor(hands: Readonly<Record<Side, FeltHand>>) {
    this.#hands = hands;
  }

  /** Take a document: a pause and a throw are felt by both hands. */
  receive({ session, ball }: Pick<LiveDocument, "session" | "ball">): void {
    const [isPaused, isFlying] = [session?.state === "paused", ball?.phase === "flying"];
    if (isPaused && !this.#wasPaused) this.#both(WARNING);
    if (isFlying && !this.#wasFlying) this.#both(THROWN);
    this.#wasPaused = isPaused;
    this.#wasFlying = isFlying;
  }

  /** A person who is outside of the bounds feels it until they are back. */
  warn(isOutside: boolean, nowMs: number): void {
    if (!isOutside || nowMs - this.#warnedMs < WARN_EVERY_MS) return;
    this.#warnedMs = nowMs;
    this.#both(WARNING);
  }

  /** Take where the flying ball is in a frame, null without one. */
  touch(ball: Readonly<Vector> | null, reachM: number): void {
    for (const side of SIDES) {
      const { isTracked, position } = this.#hands[side];
      if (this.#contacts[side].update(ball, isTracked ? position : null, reachM)) this.contact(side);
    }
  }

  /** A hand touches something. */
  contact(side: Side): void {
    this.#hands[side].pulse(...CONTACT);
  }

  #both([intensity, ms]: readonly [number, number]): void {
    for (const side of SIDES) this.#hands[side].pulse(intensity, ms);
  }
}
