/** Open incidents by element and cause; a row shows the processes that have them. */
import { useMemo } from "react";
import { useTranslation } from "react-i18next";
import type { CauseView } from "~/api/generated/task-orchestrator";
import { DataTable, type Column } from "~/design/table/DataTable";
import { useSorting } from "~/design/table/useSorting";
import { RelativeTime } from "~/design/RelativeTime";
import { localizedText } from "~/i18n/server";
import { useFigureColumns } from "./figures";

export interface CauseTableProps {
  rows: readonly CauseView[];
  isLoaded: boolean;
  onPick: (element: string) => void;
}

export function CauseTable({ rows, isLoaded, onPick }: CauseTableProps) {
  const { t } = useTranslation("cockpit");
  const [sorting, setSorting] = useSorting("-count", "causeSort");
  const { count } = useFigureColumns<CauseView>();
  const columns: readonly Column<CauseView>[] = useMemo(
    () => [
      count("count", t("causes.count")),
      {
        id: "element",
        name: t("causes.element"),
        width: "minmax(140px, 1.4fr)",
        sortBy: nameOf,
        cell: (row) => (
          <>
            <span className="cell__name">{nameOf(row)}</span>
            <p className="cell__detail">{row.title}</p>
          </>
        ),
      },
      { id: "reason", name: t("causes.reason"), width: "minmax(160px, 2.4fr)", sortBy: (row) => row.reason, cell: (row) => <span>{localizedText(row, "reason")}</span> },
      { id: "since", name: t("causes.since"), width: "minmax(90px, 0.8fr)", sortBy: (row) => row.since, cell: (row) => <RelativeTime at={row.since} /> },
    ],
    [t, count],
  );
  if (isLoaded && rows.length === 0) return <p className="quiet">{t("causes.none")}</p>;
  return (
    <DataTable
      label={t("causes.title")}
      rows={rows}
      columns={columns}
      keyOf={(row) => `${row.definition}@${row.version} ${row.element} ${row.reasonCode ?? row.reason}`}
      nameOf={(row) => `${nameOf(row)}: ${row.count}`}
      rowHeight={56}
      isLabelled
      isCompact
      sorting={sorting}
      onSort={setSorting}
      onOpen={(row) => onPick(row.element.split(".")[0] ?? row.element)}
    />
  );
}

function nameOf({ name, element }: CauseView): string {
  return name === "" ? element : name;
}
