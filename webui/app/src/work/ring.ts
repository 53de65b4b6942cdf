/** The drawn part of the ring. */

/** Frames arrive 20 to 200 times a second: after this time without a frame the ring stops. */
const BEYOND_MS = 120;

export interface Held {
  heldMs: number;
  announceMs: number;
  confirmMs: number;
}

/** The part of the ring, 0 to 1, `sinceMs` after `held` was received: it opens when announced, closes when confirmed. */
export function ringPart({ heldMs, announceMs, confirmMs }: Held, sinceMs: number): number {
  if (heldMs <= 0) return 0;
  const nowMs = heldMs + Math.min(Math.max(0, sinceMs), BEYOND_MS);
  const part = (nowMs - announceMs) / Math.max(1, confirmMs - announceMs);
  return Math.min(1, Math.max(0, part));
}
