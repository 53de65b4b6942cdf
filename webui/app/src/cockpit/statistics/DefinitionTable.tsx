/** All definitions with what became of their processes; a row opens the heat map of its definition. */
import { useMemo } from "react";
import { useTranslation } from "react-i18next";
import type { DefinitionTimes } from "~/api/generated/task-orchestrator";
import { DataTable, type Column } from "~/design/table/DataTable";
import { useSorting } from "~/design/table/useSorting";
import { useFigureColumns } from "./figures";

export function DefinitionTable({ rows, onOpen }: { rows: readonly DefinitionTimes[]; onOpen: (name: string) => void }) {
  const { t } = useTranslation("cockpit");
  const [sorting, setSorting] = useSorting("-started", "definitionSort");
  const { count, percentile } = useFigureColumns<DefinitionTimes>();
  const columns: readonly Column<DefinitionTimes>[] = useMemo(
    () => [
      { id: "title", name: t("bar.definition"), width: "minmax(160px, 2fr)", sortBy: (row) => row.title, cell: (row) => <span className="cell__name">{row.title}</span> },
      count("running", t("totals.running")),
      count("withIncidents", t("totals.withIncidents")),
      count("started", t("totals.started")),
      count("completed", t("totals.completed")),
      count("failed", t("totals.failed")),
      percentile("medianMs", t("totals.medianMs")),
      percentile("p90Ms", t("totals.p90Ms")),
    ],
    [t, count, percentile],
  );
  return (
    <DataTable
      label={t("definitions.title")}
      rows={rows}
      columns={columns}
      keyOf={(row) => row.definition}
      nameOf={(row) => row.title}
      rowHeight={40}
      isLabelled
      isCompact
      sorting={sorting}
      onSort={setSorting}
      onOpen={(row) => onOpen(row.definition)}
    />
  );
}
