/** How much of their available time people, robots and devices have worked. */
import { useMemo } from "react";
import { useTranslation } from "react-i18next";
import type { ResourceTimes } from "~/api/generated/task-orchestrator";
import { DataTable, type Column } from "~/design/table/DataTable";
import { useSorting } from "~/design/table/useSorting";
import { percent } from "~/design/numbers";
import { shortName } from "~/live/urn";
import { Bar, useFigureColumns } from "./figures";

export function ResourceTable({ rows, isLoaded }: { rows: readonly ResourceTimes[]; isLoaded: boolean }) {
  const { t, i18n } = useTranslation("cockpit");
  const [sorting, setSorting] = useSorting("-utilisation", "resourceSort");
  const { time } = useFigureColumns<ResourceTimes>();
  const columns: readonly Column<ResourceTimes>[] = useMemo(
    () => [
      { id: "resource", name: t("resources.resource"), width: "minmax(120px, 1.5fr)", sortBy: (row) => shortName(row.resource), cell: (row) => <span className="cell__name">{shortName(row.resource)}</span> },
      time("workingMs", t("resources.working")),
      time("availableMs", t("resources.available")),
      {
        id: "utilisation",
        name: t("resources.utilisation"),
        width: "minmax(140px, 2fr)",
        sortBy: (row) => row.utilisation,
        isDescendingFirst: true,
        cell: (row) => {
          if (row.utilisation === null) return <span>–</span>;
          const said = percent(row.utilisation, i18n.language, 1);
          return (
            <span className="cockpit__share">
              <Bar parts={[{ kind: "used", share: row.utilisation, title: said }]} />
              <span>{said}</span>
            </span>
          );
        },
      },
    ],
    [t, i18n.language, time],
  );
  if (isLoaded && rows.length === 0) return <p className="quiet">{t("resources.none")}</p>;
  return (
    <DataTable
      label={t("resources.title")}
      rows={rows}
      columns={columns}
      keyOf={(row) => row.resource}
      nameOf={(row) => shortName(row.resource)}
      rowHeight={40}
      isLabelled
      isCompact
      sorting={sorting}
      onSort={setSorting}
    />
  );
}
