/**
 * The clock of the robot as the page sees it. Documents arrive late by a delay that varies; the least delay of the last
 * seconds is the path without queues, and half of the least echo is what remains of it to be made up for.
 */
const WINDOW_S = 3;
const HALVES = 2;
/** A newer document is not later than this: the clock of a simulation may be slower than ours. */
const MOST_QUEUE_S = 0.05;
/** A robot whose clock jumps has been started again. */
const RESTARTED_S = 0.5;

export class RobotClock {
  /** Of arrival and robot, the least of the present and the former half of the window. */
  readonly #least = new Float64Array(HALVES).fill(Infinity);
  #sinceS = -Infinity;
  #echoS = 0;
  #lastT = -Infinity;
  #lastS = -Infinity;

  /** Take a document of the robot's time `t` that arrived at `nowS` of the page. Both in s. */
  receive(nowS: number, t: number): void {
    if (!Number.isFinite(nowS + t)) return;
    if (t < this.#lastT - RESTARTED_S) this.#least.fill(Infinity);
    this.#lastT = t;
    this.#lastS = nowS;
    if (nowS - this.#sinceS > WINDOW_S / HALVES) {
      this.#least[1] = this.#least[0] ?? Infinity;
      this.#least[0] = Infinity;
      this.#sinceS = nowS;
    }
    this.#least[0] = Math.min(this.#least[0] ?? Infinity, nowS - t);
  }

  /** Take how long an echo took. */
  echo(seconds: number): void {
    if (!(seconds >= 0)) return;
    // falls at once, rises slowly: a queue is no property of the path
    this.#echoS = this.#echoS === 0 || seconds < this.#echoS ? seconds : this.#echoS + 0.05 * (seconds - this.#echoS);
  }

  get isKnown(): boolean {
    return Number.isFinite(Math.min(...this.#least));
  }

  /** The delay from the robot to the page, in s. */
  get linkS(): number {
    return this.#echoS / 2;
  }

  /** The newest time of the robot that could have arrived at `nowS`. */
  arrived(nowS: number): number {
    const least = Math.min(this.#least[0] ?? Infinity, this.#least[1] ?? Infinity);
    return Math.min(nowS - least, this.#lastT + nowS - this.#lastS + MOST_QUEUE_S);
  }

  /** The time of the robot at `nowS`. */
  now(nowS: number): number {
    return this.arrived(nowS) + this.linkS;
  }
}
