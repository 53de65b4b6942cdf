/** The acts of a situation, in one place at the foot of the page: the main one is always visible. */
import { CircleX, MessageSquareWarning } from "lucide-react";
import { useTranslation } from "react-i18next";
import { useLocation } from "wouter";
import { declareGlove } from "~/api/actions";
import { Button } from "~/design/Button";
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
    case "asked":
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
    case "failed": {
      const { process, startable } = situation;
      const again = process.retry === null ? undefined : startable.find(({ name }) => name === process.definition);
      return (
        <>
          {mayLeave && (
            <Button size="large" onPress={() => go(`/processes/${process.id}`)}>
              {t("by.processes")}
            </Button>
          )}
          {again !== undefined && (
            <Button size="large" isDisabled={acting.busy} onPress={() => acts.start?.(again)}>
              {t("by.startAgain", { title: again.title })}
            </Button>
          )}
        </>
      );
    }
    case "serviceLost":
      return (
        mayLeave && (
          <Button size="large" onPress={() => go("/system")}>
            {t("by.system")}
          </Button>
        )
      );
    case "noGlove":
      return (
        <Button size="large" isDisabled={acting.busy} onPress={() => acting.perform(() => declareGlove(situation.chosen ?? "glove-1"))}>
          {t("by.screen")}
        </Button>
      );
    default:
      return null;
  }
}
