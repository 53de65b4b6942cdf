/** Reports "not good" or a problem, with an optional note and a confirmation. */
import { useState } from "react";
import { Label, TextArea, TextField } from "react-aria-components";
import { useTranslation } from "react-i18next";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import type { Outcome } from "~/live/messages";

export type ReportedOutcome = Exclude<Outcome, "ok">;

/** The limit of the gesture controller. */
const MAX_NOTE = 500;

export interface ReportPanelProps {
  outcome: ReportedOutcome;
  /** The name of the Task. */
  task: string;
  onReport: (outcome: Outcome, note: string) => Promise<void>;
  onClose: () => void;
}

export function ReportPanel({ outcome, task, onReport, onClose }: ReportPanelProps) {
  const { t } = useTranslation("work");
  const [note, setNote] = useState("");
  return (
    <ConfirmDialog
      isOpen
      onClose={onClose}
      title={t(`report.${outcome}.title`)}
      act={t(`report.${outcome}.act`)}
      kind="stop"
      size="large"
      onAct={() => onReport(outcome, note.trim())}
    >
      <p>{task}</p>
      <p className="quiet">{t(`report.${outcome}.means`)}</p>
      <TextField className="report__note" value={note} onChange={setNote} maxLength={MAX_NOTE}>
        <Label>{t("report.note")}</Label>
        <TextArea rows={2} />
      </TextField>
    </ConfirmDialog>
  );
}
