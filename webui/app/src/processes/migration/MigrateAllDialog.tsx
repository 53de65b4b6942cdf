/** Continues the running processes of a version in the latest one, each if it can. */
import { useQuery } from "@tanstack/react-query";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { migrateProcesses } from "~/api/actions";
import type { MigrationOfAllView } from "~/api/generated/task-orchestrator";
import { errorText } from "~/api/http";
import { queryClient } from "~/api/useServiceQuery";
import { ErrorMessage } from "~/design/ErrorMessage";
import { MendDialog } from "../incidents/MendDialog";
import { Findings } from "./Findings";

export interface MigrateAllDialogProps {
  definition: string;
  title: string;
  source: number;
  target: number;
  onClose: () => void;
}

export function MigrateAllDialog({ definition, title, source, target, onClose }: MigrateAllDialogProps) {
  const { t } = useTranslation("processes");
  const [request] = useState({ source, version: target });
  const check = useQuery(
    { queryKey: ["migration of all", definition, request], queryFn: () => migrateProcesses(definition, { by: "-", ...request }, true) },
    queryClient,
  );
  const report = check.data;
  const possible = report === undefined ? 0 : report.processes.length - report.refused;
  return (
    <MendDialog
      title={t("migration.allTitle", { title, source })}
      act={t("migration.allAct", { count: possible, version: target })}
      means={t("migration.means")}
      isDisabled={possible === 0}
      onClose={onClose}
      onAct={({ by, why }) => migrateProcesses(definition, { by, ...(why === undefined ? {} : { why }), ...request })}
    >
      {check.error !== null && <ErrorMessage>{errorText(check.error)}</ErrorMessage>}
      {report !== undefined && <Refused report={report} />}
    </MendDialog>
  );
}

/** The processes that cannot be migrated, each with its obstacles. */
function Refused({ report }: { report: MigrationOfAllView }) {
  const { t } = useTranslation("processes");
  if (report.refused === 0) return null;
  return (
    <details>
      <summary>{t("migration.refused", { count: report.refused })}</summary>
      {report.processes
        .filter(({ possible }) => !possible)
        .map(({ process, findings }) => (
          <section key={process} aria-label={process}>
            <p>{process}</p>
            <Findings findings={findings.filter(({ obstacle }) => obstacle)} />
          </section>
        ))}
    </details>
  );
}
