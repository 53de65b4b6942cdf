/** Numbers that move to new targets with an ease-out animation. */
import { useEffect, useRef, useState } from "react";

export function useEased(target: readonly number[], moveMs: number, from?: readonly number[]): readonly number[] {
  const [eased, setEased] = useState<readonly number[]>(() => (moves() ? (from ?? target) : target));
  const now = useRef(eased);
  const targetKey = target.join(" ");
  useEffect(() => {
    const end = targetKey.split(" ").map(Number);
    const start = now.current;
    const show = (numbers: readonly number[]) => {
      now.current = numbers;
      setEased(numbers);
    };
    if (start.join(" ") === targetKey) return;
    let frame = 0;
    let beganMs: number | null = null;
    const step = (atMs: number) => {
      beganMs ??= atMs;
      const part = moves() ? Math.min(1, (atMs - beganMs) / moveMs) : 1;
      const eased = part < 0.5 ? 2 * part * part : 1 - 2 * (1 - part) * (1 - part);
      show(part === 1 ? end : end.map((goal, index) => (start[index] ?? goal) + (goal - (start[index] ?? goal)) * eased));
      if (part < 1) frame = requestAnimationFrame(step);
    };
    frame = requestAnimationFrame(step);
    return () => cancelAnimationFrame(frame);
  }, [targetKey, moveMs]);
  return eased;
}

function moves(): boolean {
  return typeof matchMedia === "undefined" || !matchMedia("(prefers-reduced-motion: reduce)").matches;
}
