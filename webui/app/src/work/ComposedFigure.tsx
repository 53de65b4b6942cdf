/** A gesture of both hands or of two in sequence: both parts with their states. */
import { ArrowRight } from "lucide-react";
import { Fragment } from "react";
import { useTranslation } from "react-i18next";
import { StatusBadge, type Tone } from "~/design/StatusBadge";
import { useGestureName } from "~/hand/Hand";
import type { GesturePart, GloveView } from "~/live/messages";
import { PromptHand, DoneCheck } from "./Figure";
import { HoldRing } from "./HoldRing";
import { LiveHand, frameFor, useWornGloves } from "./LiveHand";
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
  const worn = useWornGloves(glove);
  const inTurn = parts.every(({ hand }) => hand === null);
  return (
    <ul className="figures">
      {parts.map((part, index) => {
        const state = done ? "done" : part.state;
        const live = state === "done" ? undefined : liveOver(worn, part);
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
                <PromptHand code={part.code} frameBy={frameFor(live, part.code)} side={part.hand ?? glove.hand} gesture={part.gesture} done={done} />
                {live !== undefined && <LiveHand glove={live} code={part.code} />}
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

/** The glove shown over a part: that of the hand that it is for, or in a sequence the only one over the present part. */
function liveOver(worn: readonly GloveView[], part: GesturePart): GloveView | undefined {
  if (part.hand !== null) return worn.find(({ hand }) => hand === part.hand);
  return part.state === "next" ? undefined : worn[0];
}

/** Whether the ring of a part fills: for two hands once both are right, in a sequence for the present part. */
function isHeld(glove: GloveView, parts: readonly GesturePart[], part: GesturePart): boolean {
  if (part.hand !== null) return parts.every(({ state }) => state === "held");
  return part.state === "now" && glove.states === part.code && glove.hold.gesture !== null && !glove.hold.spent;
}
