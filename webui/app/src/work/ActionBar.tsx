/** The actions of a situation, at the bottom of the page; the main one is always visible. */
import { Ban, CircleX, MessageSquareWarning } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { useLocation } from "wouter";
import { cancelProcess, declareGlove } from "~/api/actions";
import { Button } from "~/design/Button";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import type { ProcessView } from "~/api/generated/task-orchestrator";
import { addresses } from "~/places/addresses";
import { useWithName } from "~/shell/userName";
import { useParticipantMode } from "~/study/participantMode";
import type { ReportedOutcome } from "./ReportPanel";
import type { Situation } from "./situation";
import type { ActionState } from "./useAction";
import type { OperatorActions } from "./useOperatorActions";

export interface ActionBarProps {
  situation: Situation;
  acts: OperatorActions;
  acting: ActionState;
  report: (outcome: ReportedOutcome) => void;
}

export function ActionBar({ situation, acts, acting, report }: ActionBarProps) {
  const { main } = acts;
  return (
    <div className="work__buttons">
      <OtherActs situation={situation} acts={acts} acting={acting} report={report} />
      {main !== null && (
        <Button size="large" kind="main" isDisabled={acting.busy} onPress={main.do}>
          {main.name}
        </Button>
      )}
    </div>
  );
}

function OtherActs({ situation, acts, acting, report }: ActionBarProps) {
  const { t } = useTranslation("work");
  const [, go] = useLocation();
  const mayLeave = useParticipantMode() === null;
  switch (situation.kind) {
    case "prompt":
    case "gloveLost":
      return (
        acts.report !== null && (
          <>
            <Button size="large" icon={<MessageSquareWarning aria-hidden size="1.1em" />} isDisabled={acting.busy} onPress={() => report("problem")}>
              {t("outcome.problem")}
            </Button>
            <Button size="large" icon={<CircleX aria-hidden size="1.1em" />} isDisabled={acting.busy} onPress={() => report("notGood")}>
              {t("outcome.notGood")}
            </Button>
          </>
        )
      );
    case "incident":
    case "failed":
      return (
        <>
          {mayLeave && (
            <Button size="large" onPress={() => go(addresses.process(situation.process.id))}>
              {t("by.processes")}
            </Button>
          )}
          {situation.kind === "incident" && <CancelButton process={situation.process} acting={acting} />}
        </>
      );
    case "serviceLost":
      return (
        mayLeave && (
          <Button size="large" onPress={() => go(addresses.services())}>
            {t("by.system")}
          </Button>
        )
      );
    case "noGlove":
      return (
        <Button permission="configure" size="large" isDisabled={acting.busy} onPress={() => acting.perform(() => declareGlove(situation.chosen ?? "glove-1"))}>
          {t("by.screen")}
        </Button>
      );
    default:
      return null;
  }
}

/** Cancels a process that cannot continue, after a confirmation, so that another can be started. */
function CancelButton({ process, acting }: { process: ProcessView; acting: ActionState }) {
  const { t } = useTranslation("work");
  const [asks, setAsks] = useState(false);
  const { withName, question } = useWithName("large");
  return (
    <>
      <Button permission="runProcesses" size="large" icon={<Ban aria-hidden size="1.1em" />} isDisabled={acting.busy} onPress={() => setAsks(true)}>
        {t("by.cancel", { title: process.title })}
      </Button>
      <ConfirmDialog
        isOpen={asks}
        onClose={() => setAsks(false)}
        title={t("cancel.title", { title: process.title })}
        act={t("by.cancel", { title: process.title })}
        dismiss={t("cancel.keep")}
        kind="stop"
        size="large"
        onAct={() => withName((name) => cancelProcess(process.id, name))}
      >
        <p>{t("cancel.means")}</p>
      </ConfirmDialog>
      {question}
    </>
  );
}
