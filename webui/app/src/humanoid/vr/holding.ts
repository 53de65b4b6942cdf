/** Whether a hand of the person holds a hand of the robot: it closes near it, and lets go when it opens or is torn away. */
export const HOLD_M = 0.12;
/** Farther away than this from the hand of the robot a hand has been torn off, or its tracking is wrong. */
export const TORN_M = 0.35;
export const CLOSED = 0.5;

export class Holding {
  #holds = false;
  #wasClosed = false;

  get holds(): boolean {
    return this.#holds;
  }

  /** Take the grip from 0 to 1 and the distance from the hand of the robot; NaN or null is a hand that is not tracked. */
  update(grip: number, distanceM: number | null): boolean {
    const isClosed = grip >= CLOSED;
    const isNew = isClosed && !this.#wasClosed;
    this.#wasClosed = isClosed;
    if (!isClosed || distanceM === null || !(distanceM <= TORN_M)) this.#holds = false;
    else if (isNew && distanceM <= HOLD_M) this.#holds = true;
    return this.#holds;
  }
}
