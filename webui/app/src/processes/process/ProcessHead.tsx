/** The heading of a process: its definition, state and actions. */
import { Ban, GitBranch } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import { RelativeTime } from "~/design/RelativeTime";
import { Button } from "~/design/Button";
import { StatusBadge } from "~/design/StatusBadge";
import { processTone } from "~/design/states";
import { duration } from "~/design/times";
import { localizedText } from "~/i18n/server";
import { useNow } from "~/live/clock";
import { useTopic } from "~/live/hooks";
import type { ProcessView } from "~/api/generated/task-orchestrator";
import { processState } from "~/live/processState";
import { sentence } from "~/live/readable";
import { pathOf } from "../address";
import { MigrateDialog } from "../migration/MigrateDialog";
import { shortTitle } from "../names";
import { PaceButton } from "../pause/PaceButton";
import { CancelDialog } from "./CancelDialog";

export function ProcessHead({ process }: { process: ProcessView }) {
  const { t } = useTranslation(["processes", "common"]);
  const last = process.acts.at(-1);
  const state = processState(process);
  return (
    <header className="process__head">
      <div className="process__name">
        <h1 className="process__mark" title={process.id}>{process.name}</h1>
        <StatusBadge tone={processTone[state]}>{t(`common:processStatus.${state}`)}</StatusBadge>
        <Link href={pathOf({ kind: "definition", name: process.definition })}>
          {process.title}, {t("version", { version: process.version })}
        </Link>
        <span className="quiet">
          {t("process.progress", { done: process.done, all: process.activities })} · <Took process={process} />
        </span>
        <span className="quiet">
          {t("process.started")} <RelativeTime at={process.startedAt} isStop />
        </span>
      </div>
      <Acts process={process} />
      {process.reason !== null && last?.act !== "cancel" && <p className="process__reason">{sentence(localizedText(process, "reason") ?? "")}</p>}
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
  const [asks, setAsks] = useState(false);
  const [migrates, setMigrates] = useState(false);
  const newest = useTopic(`definition/${process.definition}`)?.version ?? process.version;
  return (
    <div className="process__actions">
      {process.endedAt === null && newest > 1 && (
        <Button permission="runProcesses" icon={<GitBranch aria-hidden size={18} />} onPress={() => setMigrates(true)}>
          {t("migration.open")}
        </Button>
      )}
      {migrates && <MigrateDialog process={process} newest={newest} onClose={() => setMigrates(false)} />}
      {process.endedAt === null && <PaceButton pace={process.status === "paused" ? "resume" : "pause"} of={{ process: process.id, title: process.name }} />}
      {process.endedAt === null && (
        <Button permission="runProcesses" icon={<Ban aria-hidden size={18} />} onPress={() => setAsks(true)}>
          {t("cancel.act", { title: shortTitle(process.name) })}
        </Button>
      )}
      {asks && <CancelDialog process={process} onClose={() => setAsks(false)} />}
    </div>
  );
}
