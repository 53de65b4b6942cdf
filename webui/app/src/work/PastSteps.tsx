/** The finished steps, to be looked at again while the present one keeps running. */
import { Check, CircleX, MessageSquareWarning, Undo2 } from "lucide-react";
import { Dialog, Heading, Modal, ModalOverlay } from "react-aria-components";
import { useTranslation } from "react-i18next";
import type { ProcessView } from "~/api/generated/task-orchestrator";
import { Button } from "~/design/Button";
import "~/design/ConfirmDialog.css";
import { useGestureName } from "~/hand/Hand";
import { pastSteps, type PastStep } from "./pastSteps";
import "./PastSteps.css";

const icons = { ok: Check, notGood: CircleX, problem: MessageSquareWarning, failed: CircleX, cancelled: Undo2 } as const;

interface PastStepsProps {
  process: ProcessView;
  /** The step that runs meanwhile. */
  present: string | null;
  onClose: () => void;
}

export function PastSteps({ process, present, onClose }: PastStepsProps) {
  const { t, i18n } = useTranslation("work");
  const clock = new Intl.DateTimeFormat(i18n.language, { hour: "2-digit", minute: "2-digit", second: "2-digit", hourCycle: "h23" });
  return (
    <ModalOverlay className="confirm-dialog__overlay" isOpen onOpenChange={(isOpen) => !isOpen && onClose()} isDismissable>
      <Modal className="confirm-dialog confirm-dialog--large past-steps">
        <Dialog className="confirm-dialog__dialog">
          <Heading slot="title" className="confirm-dialog__title">
            {t("past.title")}
          </Heading>
          {present !== null && <p className="past-steps__present">{t("past.present", { task: present })}</p>}
          <ol className="past-steps__list" tabIndex={0} aria-label={t("past.title")}>
            {pastSteps(process).map((step) => (
              <Row key={step.id} step={step} time={clock.format(Date.parse(step.endedAt))} />
            ))}
          </ol>
          <div className="confirm-dialog__actions">
            <Button size="large" kind="main" onPress={onClose}>
              {t("past.close")}
            </Button>
          </div>
        </Dialog>
      </Modal>
    </ModalOverlay>
  );
}

function Row({ step, time }: { step: PastStep; time: string }) {
  const { t } = useTranslation("work");
  const nameOf = useGestureName();
  const Icon = icons[step.answer];
  return (
    <li className="past-steps__step" data-answer={step.answer}>
      <time dateTime={step.endedAt}>{time}</time>
      <strong>{step.asked}</strong>
      <span className="past-steps__answer">
        <Icon aria-hidden size="1em" />
        <span>
          {answer()}
          {step.note !== null && ` ${t("reported.note", { note: step.note })}`}
        </span>
      </span>
    </li>
  );

  function answer(): string {
    const { operator, gesture } = step;
    if (step.answer === "notGood" || step.answer === "problem") {
      const what = t(`outcome.${step.answer}`);
      return operator === null ? what : t("past.reported", { what, who: operator });
    }
    if (step.answer !== "ok") return t(`past.${step.answer}`);
    if (step.by === "gesture") return gesture === null ? t("confirmed") : t("past.gesture", { gesture: nameOf(gesture) });
    return step.by === "screen" && operator !== null ? t("confirmedBy", { operator }) : t("past.done");
  }
}
