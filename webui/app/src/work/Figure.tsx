/** The requested gesture in its ring, the live hand over it, and the check mark after it was confirmed. */
import { Check } from "lucide-react";
import { memo } from "react";
import { Hand, useGestureName } from "~/hand/Hand";
import type { GloveView } from "~/live/messages";
import { HoldRing } from "./HoldRing";
import { LiveHand, frameFor } from "./LiveHand";
import "./Figure.css";

export interface FigureProps {
  glove: GloveView;
  gesture: string;
  code: string;
  /** Whether a hold counts now. */
  open: boolean;
  done?: boolean;
}

export function Figure({ glove, gesture, code, open, done = false }: FigureProps) {
  const right = open && glove.states === code && glove.hold.gesture !== null && !glove.hold.spent;
  return (
    <div className="figure">
      <HoldRing hold={glove.hold} right={right} closed={done} />
      <PromptHand code={code} frameBy={done ? code : frameFor(glove, code)} side={glove.hand} gesture={gesture} done={done} />
      {!done && <LiveHand glove={glove} code={code} />}
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

interface PromptHandProps {
  code: string;
  /** The states whose close-up is the frame. */
  frameBy: string;
  side: "left" | "right";
  gesture: string;
  done?: boolean;
}

/** Rendered once per step, not for every frame of the glove; animated from the open hand unless done. */
export const PromptHand = memo(function PromptHand({ code, frameBy, side, gesture, done = false }: PromptHandProps) {
  const nameOf = useGestureName();
  return <Hand states={code} side={side} {...(done ? {} : { animateFrom: "00000" })} closeUp frameBy={frameBy} label={nameOf(gesture)} />;
});
