/** The questions before acts: those that the pages ask, for the object that was chosen in the palette. */
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { acknowledge } from "~/api/actions";
import type { DefinitionView, ProcessView } from "~/api/generated/task-orchestrator";
import { ApiError } from "~/api/http";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { RelativeTime } from "~/design/RelativeTime";
import { localizedText } from "~/i18n/server";
import { useProcessTexts, useTopic } from "~/live/hooks";
import type { AlertView } from "~/live/messages";
import { addresses } from "~/places/addresses";
import { MigrateDialog } from "~/processes/migration/MigrateDialog";
import { PaceDialog, type PaceProps } from "~/processes/pause/PaceDialog";
import { CancelDialog } from "~/processes/process/CancelDialog";
import { StartDialog } from "~/processes/start/StartDialog";
import { useSession } from "~/session/session";
import { setUserName, UserNameField, userName } from "~/shell/userName";
import type { QuestionProps } from "./acts";
import type { Entry } from "./entries";

export function StartQuestion({ subject, onClose, onDone }: QuestionProps) {
  const chosen = subject?.value as DefinitionView;
  const newest = useTopic(`definition/${chosen.name}`);
  const texts = useProcessTexts();
  return <StartDialog definition={newest ?? texts.localized(chosen)} version={null} onClose={onClose} onStarted={({ id }) => onDone(addresses.process(id))} />;
}

export function PauseQuestion(props: QuestionProps) {
  return <PaceQuestion {...props} pace="pause" />;
}

export function ResumeQuestion(props: QuestionProps) {
  return <PaceQuestion {...props} pace="resume" />;
}

function PaceQuestion({ subject, pace, onClose, onDone }: QuestionProps & Pick<PaceProps, "pace">) {
  return <PaceDialog pace={pace} of={scopeOf(subject)} onClose={onClose} onDone={onDone} />;
}

function scopeOf(subject: Entry | undefined): PaceProps["of"] {
  if (subject === undefined) return "everything";
  if (subject.kind === "process") return { process: (subject.value as ProcessView).id, title: subject.name };
  return { definition: (subject.value as DefinitionView).name, title: subject.name };
}

/** The process as it is now, in the language of the page. */
function useNow(subject: Entry | undefined): ProcessView {
  const chosen = subject?.value as ProcessView;
  const texts = useProcessTexts();
  return useTopic(`process/${chosen.id}`) ?? texts.localized(chosen);
}

export function CancelQuestion({ subject, onClose, onDone }: QuestionProps) {
  return <CancelDialog process={useNow(subject)} onClose={onClose} onDone={onDone} />;
}

export function MigrateQuestion({ subject, onClose }: QuestionProps) {
  const process = useNow(subject);
  const newest = useTopic(`definition/${process.definition}`)?.version ?? process.version;
  return <MigrateDialog process={process} newest={newest} onClose={onClose} />;
}

export function AcknowledgeQuestion({ subject, onClose, onDone }: QuestionProps) {
  const { t } = useTranslation(["palette", "common"]);
  const { hasAccounts } = useSession();
  const [by, setBy] = useState(userName);
  const alert = subject?.value as AlertView;
  const name = subject?.name ?? "";
  return (
    <ConfirmDialog
      isOpen
      onClose={onClose}
      title={t("acknowledge.title", { name })}
      act={t("acknowledge.act")}
      isDisabled={by.trim() === ""}
      onAct={async () => {
        if (!hasAccounts) setUserName(by);
        const { failed: [failure] } = await acknowledge([alert.id], by.trim());
        if (failure !== undefined) throw new ApiError(failure);
        onDone();
      }}
    >
      <p>
        {t(`common:severity.${alert.severity}`)} · {subject?.detail} · <RelativeTime at={alert.dateIssued} />
      </p>
      <p>{localizedText(alert, "description") ?? alert.description}</p>
      <UserNameField value={by} onChange={setBy} hint={t("common:who.hint")} />
    </ConfirmDialog>
  );
}
