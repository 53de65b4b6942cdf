/** The heading of a process: its definition, state and actions. */
import { Ban, RotateCcw } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import { cancelProcess, retryTask } from "~/api/actions";
import { errorText } from "~/api/http";
import { RelativeTime } from "~/design/RelativeTime";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { Button } from "~/design/Button";
import { ErrorMessage } from "~/design/ErrorMessage";
import { StatusBadge } from "~/design/StatusBadge";
import { statusTone } from "~/design/states";
import { duration } from "~/design/times";
import { localizedText } from "~/i18n/server";
import { useNow } from "~/live/clock";
import type { ProcessView, TaskView } from "~/live/messages";
import { shortName } from "~/live/urn";
import { useUserName, useWithName } from "~/shell/userName";
import { pathOf } from "../address";
import { markOf, nameOf } from "../names";

export function ProcessHead({ process }: { process: ProcessView }) {
  const { t, i18n } = useTranslation(["processes", "common"]);
  const last = process.acts.at(-1);
  return (
    <header className="process__head">
      <div className="process__name">
        <h1>
          <Link href={pathOf({ kind: "definition", name: process.definition })}>{process.title}</Link>
        </h1>
        <StatusBadge tone={statusTone[process.status]}>{t(`common:processStatus.${process.status}`)}</StatusBadge>
        <strong className="process__mark" title={process.id}>
          {markOf(process, i18n.language)}
        </strong>
        <span className="quiet">{t("version", { version: process.version })}</span>
        <span className="quiet">
          {t("process.progress", { done: process.done, all: process.activities })} · <Took process={process} />
        </span>
        <span className="quiet">
          {t("process.started")} <RelativeTime at={process.startedAt} isStop />
        </span>
      </div>
      <Acts process={process} />
      {process.reason !== null && last?.act !== "cancel" && <p className="process__reason">{localizedText(process, "reason")}</p>}
      {last !== undefined && (
        <p className="process__act quiet small">
          {t(`process.acts.${last.act}`, { by: last.by ?? t("process.somebody") })} <RelativeTime at={last.at} isStop />
        </p>
      )}
    </header>
  );
}

function Took({ process }: { process: ProcessView }) {
  const { i18n } = useTranslation();
  const now = useNow();
  const until = process.endedAt === null ? now : Date.parse(process.endedAt);
  return <>{duration(Math.floor(Math.max(0, until - Date.parse(process.startedAt)) / 1000) * 1000, i18n.language)}</>;
}

function Acts({ process }: { process: ProcessView }) {
  const { t } = useTranslation("processes");
  const name = useUserName();
  const [asks, setAsks] = useState(false);
  const failed = taskOf(process, process.retry);
  return (
    <div className="process__actions">
      {failed !== null && <RetryButton process={process} task={failed} kind="main" />}
      {process.endedAt === null && (
        <Button icon={<Ban aria-hidden size={18} />} onPress={() => setAsks(true)}>
          {t("cancel.act", { title: process.title })}
        </Button>
      )}
      <ConfirmDialog
        isOpen={asks}
        onClose={() => setAsks(false)}
        title={t("cancel.ask", { title: process.title })}
        act={t("cancel.act", { title: process.title })}
        dismiss={t("cancel.keep")}
        kind="stop"
        onAct={() => cancelProcess(process.id, name)}
      >
        <p>{t("cancel.means")}</p>
        <OpenTasks process={process} />
      </ConfirmDialog>
    </div>
  );
}

function OpenTasks({ process }: { process: ProcessView }) {
  const { t } = useTranslation("processes");
  const open = process.tasks.filter((task) => task.endedAt === null && !task.cancelled);
  if (open.length === 0) return null;
  return (
    <ul>
      {open.map((task) => (
        <li key={task.id}>
          {t("cancel.task", { task: nameOf(task), who: task.involves.map(shortName).join(", ") })}
        </li>
      ))}
    </ul>
  );
}

export interface RetryButtonProps {
  process: ProcessView;
  task: TaskView;
  kind: "main" | "plain";
}

/** Retries a failed Task under the name of the user. */
export function RetryButton({ process, task, kind }: RetryButtonProps) {
  const { t } = useTranslation("processes");
  const { withName, question } = useWithName();
  const [busy, setBusy] = useState(false);
  const [failure, setFailure] = useState<string | null>(null);
  const retry = (by: string) => retryTask(process.id, task.id, by);
  return (
    <>
      <Button
        kind={kind}
        icon={<RotateCcw aria-hidden size={18} />}
        isDisabled={busy}
        onPress={() => {
          setBusy(true);
          setFailure(null);
          void withName(retry)
            .catch((error: unknown) => setFailure(errorText(error)))
            .finally(() => setBusy(false));
        }}
      >
        {t("retry.act", { task: nameOf(task) })}
      </Button>
      {failure !== null && <ErrorMessage>{t("retry.refused", { why: failure })}</ErrorMessage>}
      {question}
    </>
  );
}

/** The Task that `retry` names: by its id, or by its URN. */
export function taskOf(process: ProcessView, id: string | null): TaskView | null {
  if (id === null) return null;
  return process.tasks.find((task) => task.id === id || shortName(task.id) === shortName(id)) ?? null;
}
