/** The gestures for the other outcomes (not good, problem): small hands with labels. */
import { memo } from "react";
import { useTranslation } from "react-i18next";
import { Hand, useGestureName } from "~/hand/Hand";
import type { AnswerOption, GloveTask, GloveView, Outcome } from "~/live/messages";

export interface AnswerHandsProps {
  task: GloveTask;
  side: GloveView["hand"];
  /** The outcome of the gesture that is held. */
  held: Outcome | null;
}

export function AnswerHands({ task, side, held }: AnswerHandsProps) {
  return (task.answers ?? []).map((answer) => <AnswerHand key={answer.outcome} {...answer} side={side} held={held === answer.outcome} />);
}

const AnswerHand = memo(function AnswerHand({ outcome, gesture, code, side, held }: AnswerOption & { side: GloveView["hand"]; held: boolean }) {
  const { t } = useTranslation("work");
  const nameOf = useGestureName();
  if (gesture === null || code === null || outcome === "ok") return null;
  return (
    <div className="work__live work__answer" data-held={held || undefined}>
      <Hand states={code} side={side} closeUp size="var(--small-hand)" label={nameOf(gesture)} />
      <span className="work__live-word">{t(`outcome.${outcome}`)}</span>
    </div>
  );
});
