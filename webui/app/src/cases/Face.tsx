/** The face of the trainer: it looks as the advice is, and moves its mouth while it speaks. */
import type { Advice } from "./trainer";

const MOUTHS: Record<Advice, string> = { faster: "M38 72 Q60 96 82 72", keep: "M42 74 Q60 88 78 74", slower: "M46 78 Q60 82 74 78" };
const BROWS: Record<Advice, number> = { faster: -5, keep: 0, slower: 3 };

export function Face({ advice, isSpeaking }: { advice: Advice; isSpeaking: boolean }) {
  const brow = 40 + BROWS[advice];
  return (
    <svg className="trainer__face" viewBox="0 0 120 120" aria-hidden data-speaking={isSpeaking || undefined}>
      <circle cx="60" cy="60" r="52" className="trainer__head" />
      <path d={`M34 ${brow} h18 M68 ${brow} h18`} className="trainer__line" />
      <circle cx="43" cy="53" r="5" className="trainer__eye" />
      <circle cx="77" cy="53" r="5" className="trainer__eye" />
      {isSpeaking ? <ellipse cx="60" cy="80" rx="14" ry="9" className="trainer__mouth" /> : <path d={MOUTHS[advice]} className="trainer__line" />}
    </svg>
  );
}
