/** Asks before a process is cancelled, and lists the Tasks that are withdrawn. */
import { useTranslation } from "react-i18next";
import { cancelProcess } from "~/api/actions";
import type { ProcessView } from "~/api/generated/task-orchestrator";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { shortName } from "~/live/urn";
import { useUserName } from "~/shell/userName";
import { nameOf, shortTitle } from "../names";

interface CancelDialogProps {
  process: ProcessView;
  onClose: () => void;
  onDone?: () => void;
}

export function CancelDialog({ process, onClose, onDone }: CancelDialogProps) {
  const { t } = useTranslation("processes");
  const name = useUserName();
  const open = process.tasks.filter((task) => task.endedAt === null && !task.cancelled);
  return (
    <ConfirmDialog
      isOpen
      onClose={onClose}
      title={t("cancel.ask", { title: process.name })}
      act={t("cancel.act", { title: shortTitle(process.name) })}
      dismiss={t("cancel.keep")}
      kind="stop"
      onAct={() => cancelProcess(process.id, name).then(() => onDone?.())}
    >
      <p>{t("cancel.means")}</p>
      {open.length > 0 && (
        <ul>
          {open.map((task) => (
            <li key={task.id}>{t("cancel.task", { task: nameOf(task), who: task.involves.map(shortName).join(", ") })}</li>
          ))}
        </ul>
      )}
    </ConfirmDialog>
  );
}
