/** A state as icon, word and colour together. */
import { CircleCheck, CircleDashed, CircleX, Info, TriangleAlert } from "lucide-react";
import type { ReactNode } from "react";
import "./StatusBadge.css";

export type Tone = "ok" | "attention" | "stop" | "accent" | "neutral";

const icons: Record<Tone, typeof CircleCheck> = {
  ok: CircleCheck,
  attention: TriangleAlert,
  stop: CircleX,
  accent: Info,
  neutral: CircleDashed,
};

export function StatusBadge({ tone, children, icon }: { tone: Tone; children: ReactNode; icon?: ReactNode }) {
  const Icon = icons[tone];
  return (
    <span className={`status-badge status-badge--${tone}`}>
      {icon ?? <Icon aria-hidden size="1.15em" />}
      <span>{children}</span>
    </span>
  );
}
