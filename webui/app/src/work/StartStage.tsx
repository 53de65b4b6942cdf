/** Nothing runs: a process can be started, with the button or with the hand. */
import { CircleCheck } from "lucide-react";
import { useEffect, useState } from "react";
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import { startOperator } from "~/api/actions";
import { Button } from "~/design/Button";
import { duration } from "~/design/times";
import { useGestureName } from "~/hand/Hand";
import type { DefinitionView, ProcessView } from "~/api/generated/task-orchestrator";
import type { GloveView } from "~/live/messages";
import { addresses } from "~/places/addresses";
import { MayNot } from "~/design/MayNot";
import { mayDo } from "~/session/session";
import { startCode, waitAfter, waiting } from "./confirmation";
import { Figure } from "./Figure";
import type { ActionState } from "./useAction";

const START_GESTURE = "Thumbs up";

export interface StartStageProps {
  glove: GloveView;
  startable: readonly DefinitionView[];
  /** The process that was just completed. */
  completed: ProcessView | null;
  acting: ActionState;
  onStart: (definition: DefinitionView) => void;
}

export function StartStage({ glove, startable, completed, acting, onStart }: StartStageProps) {
  const { t, i18n } = useTranslation("work");
  const nameOf = useGestureName();
  const [first, ...others] = startable;
  const open = first !== undefined && !acting.busy && !glove.testing && !glove.paused;
  const counted = useHold(glove);
  useEffect(() => {
    if (counted && open) onStart(first);
    // A hold counts once: other changes must not start a process.
    // eslint-disable-next-line react-hooks/exhaustive-deps
  }, [counted]);
  const gesture = nameOf(START_GESTURE);
  return (
    <>
      <Figure glove={glove} gesture={START_GESTURE} code={startCode} open={open} />
      <div className="work__text">
        <h1 className="work__task work__task--large">
          {completed === null ? (
            t("idle.title")
          ) : (
            <span className="work__completed">
              <CircleCheck aria-hidden /> {t("completed.title", { title: completed.title })}
            </span>
          )}
        </h1>
        {completed?.endedAt != null && (
          <p className="work__message">
            {t("completed.took", {
              duration: duration(Date.parse(completed.endedAt) - Date.parse(completed.startedAt), i18n.language),
            })}
          </p>
        )}
        {first === undefined ? (
          <p className="work__message">
            {t("idle.none")} <Link href={addresses.processes()}>{t("idle.noneDo")}</Link>
          </p>
        ) : (
          mayDo("runProcesses") && <p className="work__task">
            {acting.busy ? t("idle.starting") : glove.connected ? t("idle.gesture", { gesture, title: first.title }) : t("idle.button", { title: first.title })}
          </p>
        )}
        <MayNot permission="runProcesses" className="work__message" />
        {glove.testing && <p className="work__notice">{t("testing")}</p>}
        {!glove.connected && (
          <div className="work__aside">
            <p>{t("idle.noGlove", { glove: glove.glove })}</p>
            <Button permission="configure" size="large" isDisabled={acting.busy} onPress={() => acting.perform(() => startOperator(glove.glove))}>
              {t("by.simulate")}
            </Button>
          </div>
        )}
        {others.length > 0 && mayDo("runProcesses") && (
          <div className="work__aside">
            <p>{t("idle.more")}</p>
            {others.slice(0, 3).map((definition) => (
              <Button permission="runProcesses" key={definition.name} size="large" isDisabled={acting.busy} onPress={() => onStart(definition)}>
                {t("by.start", { title: definition.title })}
              </Button>
            ))}
          </div>
        )}
      </div>
    </>
  );
}

/** Whether the hand has held the start gesture to the end since the component was mounted. */
function useHold(glove: GloveView): boolean {
  const [wait, setWait] = useState(waiting);
  const now = waitAfter(wait, glove);
  if (now.open !== wait.open || now.counted !== wait.counted) setWait(now);
  return now.counted;
}
