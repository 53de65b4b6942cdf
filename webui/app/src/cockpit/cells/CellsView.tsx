/** The cells on the broker: which of them runs, what it has to do, and where somebody has to look. */
import { useMemo } from "react";
import { useTranslation } from "react-i18next";
import { useServiceQuery } from "~/api/useServiceQuery";
import { useFigureColumns } from "~/cockpit/statistics/figures";
import { ErrorMessage } from "~/design/ErrorMessage";
import { RelativeTime } from "~/design/RelativeTime";
import { StatusBadge, type Tone } from "~/design/StatusBadge";
import { DataTable, type Column } from "~/design/table/DataTable";
import { useSorting } from "~/design/table/useSorting";
import type { CellSummary } from "~/live/messages";

const REFRESH_MS = 10_000;
const TONES: Record<CellSummary["state"], Tone> = { running: "ok", stopped: "neutral", silent: "stop" };

export function useCells() {
  return useServiceQuery<CellSummary[]>("webui", "cells", { intervalMs: REFRESH_MS });
}

export function CellsView() {
  const { t } = useTranslation("cockpit");
  const { value, failure } = useCells();
  const [sorting, setSorting] = useSorting("", "cellSort");
  return (
    <section className="cockpit__section" aria-label={t("view.cells")}>
      {failure !== null && <ErrorMessage>{t("cells.unread", { why: failure })}</ErrorMessage>}
      <DataTable
        label={t("view.cells")}
        rows={value ?? []}
        columns={useColumns()}
        keyOf={(cell) => `${cell.tenant}/${cell.name}`}
        nameOf={(cell) => cell.name}
        rowHeight={56}
        isLabelled
        sorting={sorting}
        onSort={setSorting}
      />
    </section>
  );
}

function useColumns(): readonly Column<CellSummary>[] {
  const { t } = useTranslation("cockpit");
  const { count } = useFigureColumns<CellSummary>();
  return useMemo(
    () => [
      {
        id: "name", name: t("cells.name"), width: "minmax(120px, 1.5fr)", sortBy: (cell) => cell.name,
        cell: (cell) => (
          <>
            <span className="cell__name">{cell.name}</span>
            {cell.tenant !== "" && <p className="cell__detail">{t("cells.tenant", { tenant: cell.tenant })}</p>}
          </>
        ),
      },
      {
        id: "state", name: t("cells.state"), width: "minmax(150px, 1.2fr)", sortBy: (cell) => cell.state,
        cell: (cell) => (
          <>
            <StatusBadge tone={TONES[cell.state]}>{t(`cells.states.${cell.state}`)}</StatusBadge>
            {cell.state !== "running" && <p className="cell__detail"><RelativeTime at={cell.lastSeen} /></p>}
          </>
        ),
      },
      count("alerts", t("cells.alerts")),
      count("incidents", t("cells.incidents")),
      count("runningProcesses", t("cells.running")),
      count("unfinishedTasks", t("cells.tasks")),
      count("completedLastHour", t("cells.completed")),
      count("failedLastHour", t("cells.failed")),
    ],
    [t, count],
  );
}
