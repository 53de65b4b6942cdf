/** Numbers that go to where they should be in a short, calm way, from wherever they are. */
import { useEffect, useRef, useState } from "react";

export function useEased(target: readonly number[], moveMs: number, from?: readonly number[]): readonly number[] {
  const [shown, setShown] = useState<readonly number[]>(() => (moves() ? (from ?? target) : target));
  const now = useRef(shown);
  const wanted = target.join(" ");
  useEffect(() => {
    const end = wanted.split(" ").map(Number);
    const start = now.current;
    const show = (numbers: readonly number[]) => {
      now.current = numbers;
      setShown(numbers);
    };
    if (start.join(" ") === wanted) return;
    let frame = 0;
    let beganMs: number | null = null;
    const step = (atMs: number) => {
      beganMs ??= atMs;
      const part = moves() ? Math.min(1, (atMs - beganMs) / moveMs) : 1;
      const eased = part < 0.5 ? 2 * part * part : 1 - 2 * (1 - part) * (1 - part);
      show(part === 1 ? end : end.map((goal, nth) => (start[nth] ?? goal) + (goal - (start[nth] ?? goal)) * eased));
      if (part < 1) frame = requestAnimationFrame(step);
    };
    frame = requestAnimationFrame(step);
    return () => cancelAnimationFrame(frame);
  }, [wanted, moveMs]);
  return shown;
}

function moves(): boolean {
  return typeof matchMedia === "undefined" || !matchMedia("(prefers-reduced-motion: reduce)").matches;
}
