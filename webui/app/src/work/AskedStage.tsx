/** What the hand is asked for: what to do, the gesture, what the controller says, and the hand as it is. */
import { CirclePause } from "lucide-react";
import { useTranslation } from "react-i18next";
import { useGestureName } from "~/hand/Hand";
import type { GloveTask, GloveView } from "~/live/messages";
import { Figure } from "./Figure";
import { LiveHand } from "./LiveHand";
import { useSaid } from "./said";

export interface AskedStageProps {
  glove: GloveView;
  task: GloveTask;
  paused: boolean;
  answerWaits: boolean;
}

export function AskedStage({ glove, task, paused, answerWaits }: AskedStageProps) {
  const { t } = useTranslation("work");
  const nameOf = useGestureName();
  const said = useSaid();
  const gesture = nameOf(task.gesture);
  const isRight = glove.message.key === "holdOn";
  return (
    <>
      <Figure glove={glove} gesture={task.gesture} code={task.code} open={!paused && !glove.testing} />
      <div className="work__words">
        <h1 className="work__what">{task.description}</h1>
        <p className={gesture.length > 18 ? "work__gesture work__gesture--long" : "work__gesture"}>
          <span className="work__show">{t("show")}</span> {gesture}
        </p>
        <p className={isRight ? "work__said work__said--right" : "work__said"} role="status">
          {paused && (
            <span className="work__paused">
              <CirclePause aria-hidden /> {t("paused")}
            </span>
          )}
          {said(glove.message)}
        </p>
        {!glove.filtering && <p className="work__notice">{t("unfiltered")}</p>}
        {answerWaits && <p className="work__notice">{t("answerWaits")}</p>}
        <LiveHand glove={glove} />
      </div>
    </>
  );
}

/** The calm check: it has counted. */
export function DoneStage({ glove, task, operator }: { glove: GloveView; task: GloveTask; operator: string | null }) {
  const { t } = useTranslation("work");
  return (
    <>
      <Figure glove={glove} gesture={task.gesture} code={task.code} open={false} done />
      <div className="work__words" role="status">
        <h1 className="work__what quiet">{task.description}</h1>
        <p className="work__gesture work__gesture--done">
          {operator === null ? t("confirmed") : t("confirmedBy", { operator })}
        </p>
      </div>
    </>
  );
}
