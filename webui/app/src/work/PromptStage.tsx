/** A Task for the hand: description, gesture, message of the controller and the live hand. */
import { MessageSquareWarning } from "lucide-react";
import { useTranslation } from "react-i18next";
import { useGestureName } from "~/hand/Hand";
import type { GesturePart, GloveTask, GloveView, Outcome } from "~/live/messages";
import { AnswerHands } from "./AnswerHands";
import { ComposedFigure } from "./ComposedFigure";
import { Figure } from "./Figure";
import { LiveLegend } from "./LiveHand";
import "./RobotStage.css";
import { useMessageText } from "./messageText";

const single: readonly GesturePart[] = [];
const partsOf = (task: GloveTask): readonly GesturePart[] => task.parts ?? single;

export interface PromptStageProps {
  glove: GloveView;
  task: GloveTask;
  answerWaits: boolean;
}

export function PromptStage({ glove, task, answerWaits }: PromptStageProps) {
  const { t } = useTranslation("work");
  const nameOf = useGestureName();
  const messageText = useMessageText();
  const gesture = nameOf(task.gesture);
  const isRight = glove.message.key === "holdOn";
  return (
    <>
      <TaskFigure glove={glove} task={task} open={!glove.testing} />
      <div className="work__text">
        <h1 className="work__task">{task.description}</h1>
        <p className={gesture.length > 18 ? "work__gesture work__gesture--long" : "work__gesture"}>
          <span className="work__show">{t("show")}</span> {gesture}
        </p>
        <p className={isRight ? "work__message work__message--right" : "work__message"} role="status">
          {messageText(glove.message)}
        </p>
        {glove.testing && <p className="work__notice">{t("testing")}</p>}
        {!glove.filtering && <p className="work__notice">{t("unfiltered")}</p>}
        {answerWaits && <p className="work__notice">{t("answerWaits")}</p>}
        <div className="work__hands">
          <LiveLegend glove={glove} parts={partsOf(task)} />
          {glove.connected && !glove.testing && <AnswerHands task={task} side={glove.hand} held={glove.hold.outcome ?? null} />}
        </div>
      </div>
    </>
  );
}

interface TaskFigureProps {
  glove: GloveView;
  task: GloveTask;
  open: boolean;
  done?: boolean;
}

function TaskFigure({ glove, task, open, done = false }: TaskFigureProps) {
  const parts = partsOf(task);
  return parts.length > 0 ? (
    <ComposedFigure glove={glove} parts={parts} open={open} done={done} />
  ) : (
    <Figure glove={glove} gesture={task.gesture} code={task.code} open={open} done={done} />
  );
}

/** The confirmation of an answer: a check mark, or the sign of a report. */
export function DoneStage({ glove, task, operator, outcome }: { glove: GloveView; task: GloveTask; operator: string | null; outcome: Outcome }) {
  const { t } = useTranslation("work");
  if (outcome !== "ok") {
    return (
      <>
        <div className="robot-turn">
          <MessageSquareWarning aria-hidden strokeWidth={1.25} />
        </div>
        <div className="work__text" role="status">
          <h1 className="work__task quiet">{task.description}</h1>
          <p className="work__gesture work__gesture--reported">{t("reported.done", { what: t(`outcome.${outcome}`) })}</p>
        </div>
      </>
    );
  }
  return (
    <>
      <TaskFigure glove={glove} task={task} open={false} done />
      <div className="work__text" role="status">
        <h1 className="work__task quiet">{task.description}</h1>
        <p className="work__gesture work__gesture--done">
          {operator === null ? t("confirmed") : t("confirmedBy", { operator })}
        </p>
      </div>
    </>
  );
}
