/**
* The gesture that starts a process: while no Task waits, holding it to the end starts one.
 *
* The hand must be seen without the gesture first, so that the hold which answered the last Task does not start
* the next process. A hold counts once.
 */
import type { GloveView } from "~/live/messages";

export interface Wait {
  /** The hand was seen without the gesture since the page began to wait. */
  open: boolean;
  /** The hold has counted. */
  counted: boolean;
}

export const waiting: Wait = { open: false, counted: false };

/** Thumb straight, all others bent: starts a process, whatever a site calls the gesture. */
export const startCode = "02222";

/** Return the state after an update of `glove`. */
export function waitAfter(wait: Wait, glove: GloveView, code: string = startCode): Wait {
  const isShown = showsStart(glove, code);
  if (!glove.connected || glove.testing || glove.paused || glove.task !== null) return waiting;
  if (!isShown) return { open: true, counted: false };
  if (!wait.open || wait.counted) return wait;
  return { open: true, counted: glove.hold.spent || glove.hold.heldMs >= glove.hold.confirmMs };
}

/** Whether the hand shows the gesture that starts a process. */
export function showsStart(glove: GloveView, code: string = startCode): boolean {
  return glove.connected && glove.states === code && glove.hold.gesture !== null;
}

/**
 * The number of the request of a manual start: the same for every screen of this glove until a process has
 * started, so that two screens start one process.
 */
export function startRequest(glove: string, definition: string, after: string | null): string {
  const words = JSON.stringify([definition, glove, after]);
  return [0, 1].map((turn) => hashed(words, turn)).join("").slice(0, 12);
}

/** FNV-1a of 32 bits, as 8 hexadecimal digits. */
function hashed(words: string, turn: number): string {
  let hash = 0x811c9dc5 ^ turn;
  for (let index = 0; index < words.length; index += 1) hash = Math.imul(hash ^ words.charCodeAt(index), 0x01000193);
  return (hash >>> 0).toString(16).padStart(8, "0");
}
