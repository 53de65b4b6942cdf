/** The screen stays on while somebody is asked; in a kiosk it is dimmed when nobody works, until the hand moves. */
import { useEffect, useState } from "react";
import type { Situation } from "./situation";

export const REST_AFTER_MS = 120_000;
const TOUCHES = ["pointerdown", "pointermove", "keydown"] as const;
/** Touches within this time count once. */
const TOUCH_MS = 1000;

const ASKED: readonly Situation["kind"][] = ["prompt", "gloveLost", "paused", "robot", "between", "incident"];
/** Nothing that a person has to see from afar: no question, no moving robot, no fault. */
const AT_REST: readonly Situation["kind"][] = ["idle", "completed", "noGlove", "chooseGlove"];

export function isAsked({ kind }: Situation): boolean {
  return ASKED.includes(kind);
}

export function mayRest({ kind }: Situation): boolean {
  return AT_REST.includes(kind);
}

/** Keep the screen of the device on while `isWanted`, where the browser can. */
export function useWakeLock(isWanted: boolean): void {
  useEffect(() => {
    if (!isWanted || !("wakeLock" in navigator)) return;
    let lock: WakeLockSentinel | null = null;
    let isOver = false;
    const take = () => {
      if (document.hidden) return;
      navigator.wakeLock.request("screen").then(
        (taken) => {
          if (isOver) void taken.release();
          else lock = taken;
        },
        () => undefined, // the device saves energy: its own settings count
      );
    };
    take();
    document.addEventListener("visibilitychange", take); // the browser releases the lock of a hidden page
    return () => {
      isOver = true;
      document.removeEventListener("visibilitychange", take);
      void lock?.release();
    };
  }, [isWanted]);
}

/** Whether the screen is dimmed: `mayRest`, and for `REST_AFTER_MS` neither a touch nor another `hand`. */
export function useDimmed(isAtRest: boolean, hand: string): boolean {
  const [touches, setTouches] = useState(0);
  const [restsAs, setRestsAs] = useState<string | null>(null);
  const now = `${isAtRest} ${hand} ${touches}`;
  useEffect(() => {
    if (!isAtRest) return;
    const timer = setTimeout(() => setRestsAs(now), REST_AFTER_MS);
    return () => clearTimeout(timer);
  }, [isAtRest, now]);
  useEffect(() => {
    if (!isAtRest) return;
    let last = 0;
    const touch = () => {
      if (Date.now() - last < TOUCH_MS) return;
      last = Date.now();
      setTouches((count) => count + 1);
    };
    for (const name of TOUCHES) addEventListener(name, touch);
    return () => {
      for (const name of TOUCHES) removeEventListener(name, touch);
    };
  }, [isAtRest]);
  return isAtRest && restsAs === now;
}
