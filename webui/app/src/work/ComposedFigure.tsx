/** A gesture of both hands or of two in sequence: both parts with their states. */
import { ArrowRight } from "lucide-react";
import { Fragment } from "react";
import { useTranslation } from "react-i18next";
import { StatusBadge, type Tone } from "~/design/StatusBadge";
import { useGestureName } from "~/hand/Hand";
import type { GesturePart, GloveView } from "~/live/messages";
import { PromptHand, DoneCheck } from "./Figure";
import { HoldRing } from "./HoldRing";
import "./ComposedFigure.css";

export interface ComposedFigureProps {
  glove: GloveView;
  parts: readonly GesturePart[];
  /** Whether holding the gesture counts now. */
  open: boolean;
  done?: boolean;
}

const tones: Record<GesturePart["state"], Tone> = { done: "ok", held: "ok", now: "accent", next: "neutral" };

export function ComposedFigure({ glove, parts, open, done = false }: ComposedFigureProps) {
  const { t } = useTranslation("work");
  const nameOf = useGestureName();
  const inTurn = parts.every(({ hand }) => hand === null);
  return (
    <ul className="figures">
      {parts.map((part, index) => {
        const state = done ? "done" : part.state;
        return (
          <Fragment key={index}>
            {inTurn && index > 0 && (
              <li className="figures__then" aria-hidden>
                <ArrowRight width="100%" />
              </li>
            )}
            <li className="figures__part" data-state={state}>
              <div className="figure">
                <HoldRing hold={glove.hold} right={open && isHeld(glove, parts, part)} closed={state === "done"} />
                <PromptHand code={part.code} side={part.hand ?? glove.hand} gesture={part.gesture} done={done} />
                {done && <DoneCheck />}
              </div>
              <p className="figures__place">{t(`part.${part.hand ?? (index === 0 ? "first" : "second")}`)}</p>
              <p className="figures__name">{nameOf(part.gesture)}</p>
              <StatusBadge tone={tones[state]}>{t(`part.state.${state}`)}</StatusBadge>
            </li>
          </Fragment>
        );
      })}
    </ul>
  );
}

/** Whether the ring of a part fills: for two hands once both are right, in a sequence for the present part. */
function isHeld(glove: GloveView, parts: readonly GesturePart[], part: GesturePart): boolean {
  if (part.hand !== null) return parts.every(({ state }) => state === "held");
  return part.state === "now" && glove.states === part.code && glove.hold.gesture !== null && !glove.hold.spent;
}
