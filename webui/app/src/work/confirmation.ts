/**
 * A hold that the page itself waits for: with nothing asked, a gesture held to the end starts a process.
 *
 * The hand must have been seen without it first, so that a hold which answered the last Task never starts the
 * next process, and it counts once.
 */
import type { GloveView } from "~/live/messages";

export interface Wait {
  /** The hand has been seen without the gesture since the page began to wait. */
  open: boolean;
  /** The hold has counted. */
  counted: boolean;
}

export const waiting: Wait = { open: false, counted: false };

/** Thumb straight, all others bent: what starts a process, whatever a site calls it. */
export const startCode = "02222";

/** Return the wait once `glove` has been seen. */
export function waitAfter(wait: Wait, glove: GloveView, code: string = startCode): Wait {
  const shown = showsStart(glove, code);
  if (!glove.connected || glove.testing || glove.paused || glove.task !== null) return waiting;
  if (!shown) return { open: true, counted: false };
  if (!wait.open || wait.counted) return wait;
  return { open: true, counted: glove.hold.spent || glove.hold.heldMs >= glove.hold.confirmMs };
}

/** Whether the hand shows the gesture that starts a process. */
export function showsStart(glove: GloveView, code: string = startCode): boolean {
  return glove.connected && glove.states === code && glove.hold.gesture !== null;
}

/**
 * Return the key with which a process is started by hand: the same for every screen of this glove until a
 * process has begun, so that two screens start one process.
 */
export function startKey(glove: string, definition: string, after: string | null): string {
  return `${definition} by ${glove} after ${after ?? "nothing"}`.slice(0, 200);
}
