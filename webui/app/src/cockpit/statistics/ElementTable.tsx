/** The elements of a definition: how often, how long, and how the time divides into waiting, work and pauses. */
import { useMemo } from "react";
import { useTranslation } from "react-i18next";
import type { ElementTimes } from "~/api/generated/task-orchestrator";
import { DataTable, type Column } from "~/design/table/DataTable";
import { useSorting } from "~/design/table/useSorting";
import { duration } from "~/design/times";
import { Bar, useFigureColumns, type Part } from "./figures";

const PARTS = ["waiting", "working", "paused"] as const;

export interface ElementTableProps {
  rows: readonly ElementTimes[];
  picked: string;
  onPick: (element: string) => void;
}

export function ElementTable({ rows, picked, onPick }: ElementTableProps) {
  const { t, i18n } = useTranslation("cockpit");
  const [sorting, setSorting] = useSorting("", "elementSort");
  const { count, percentile } = useFigureColumns<ElementTimes>();
  const longest = Math.max(1, ...rows.map((row) => row.meanMs ?? 0));
  const columns: readonly Column<ElementTimes>[] = useMemo(
    () => [
      { id: "name", name: t("elements.name"), width: "minmax(140px, 1.8fr)", sortBy: (row) => row.name, cell: (row) => <span className="cell__name">{row.name === "" ? row.element : row.name}</span> },
      count("completed", t("totals.completed")),
      count("failed", t("totals.failed")),
      percentile("medianMs", t("totals.medianMs")),
      percentile("p90Ms", t("totals.p90Ms")),
      {
        id: "parts",
        name: t("elements.parts"),
        width: "minmax(130px, 2fr)",
        sortBy: (row) => row.waitingMs,
        isDescendingFirst: true,
        cell: (row) => {
          if (row.meanMs === null) return <span>–</span>;
          const parts: Part[] = PARTS.map((kind) => {
            const ms = row[`${kind}Ms`] ?? 0;
            return { kind, share: ms / longest, title: `${t(`elements.${kind}`)} ${duration(ms, i18n.language)}` };
          });
          return <Bar parts={parts} />;
        },
      },
    ],
    [t, i18n.language, count, percentile, longest],
  );
  return (
    <>
      <p className="bar__legend">
        {PARTS.map((kind) => (
          <span key={kind}>
            <span className={`bar__swatch bar__part--${kind}`} aria-hidden />
            {t(`elements.${kind}`)}
          </span>
        ))}
      </p>
      <DataTable
        label={t("elements.title")}
        rows={rows}
        columns={columns}
        keyOf={(row) => row.element}
        nameOf={(row) => row.name}
        rowHeight={40}
        isLabelled
        isCompact
        sorting={sorting}
        onSort={setSorting}
        openKey={picked === "" ? null : picked}
        onOpen={(row) => onPick(row.element === picked ? "" : row.element)}
      />
    </>
  );
}
