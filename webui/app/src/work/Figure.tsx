/** The hand to make in its ring, large; and the check when it has counted. */
import { Check } from "lucide-react";
import { memo } from "react";
import { Hand, useGestureName } from "~/hand/Hand";
import type { GloveView } from "~/live/messages";
import { HoldRing } from "./HoldRing";
import "./Figure.css";

export interface FigureProps {
  glove: GloveView;
  gesture: string;
  code: string;
  /** Whether holding it counts now. */
  open: boolean;
  done?: boolean;
}

export function Figure({ glove, gesture, code, open, done = false }: FigureProps) {
  const right = open && glove.states === code && glove.hold.gesture !== null && !glove.hold.spent;
  return (
    <div className="figure">
      <HoldRing hold={glove.hold} right={right} closed={done} />
      <AskedHand code={code} side={glove.hand} gesture={gesture} />
      {done && <DoneCheck />}
    </div>
  );
}

export function DoneCheck() {
  return (
    <span className="figure__check">
      <Check aria-hidden strokeWidth={3} />
    </span>
  );
}

/** It is drawn once a step, not with every frame of the glove. */
export const AskedHand = memo(function AskedHand({ code, side, gesture }: { code: string; side: "left" | "right"; gesture: string }) {
  const nameOf = useGestureName();
  return <Hand states={code} side={side} animateFrom="00000" closeUp label={nameOf(gesture)} />;
});
