/**
 * The table of all pages: columns and sorting by TanStack Table, virtual rows by `VirtualGrid`. While somebody
 * reads the table, its rows keep their order; a button shows how many new rows there are.
 */
import {
  createSortedRowModel,
  rowSortingFeature,
  tableFeatures,
  useTable,
  type ColumnDef,
  type Header,
  type SortFn,
  type SortingState,
  type Updater,
} from "@tanstack/react-table";
import { ArrowDown, ArrowUp } from "lucide-react";
import { useMemo, useRef, type ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { Button } from "~/design/Button";
import { useIsReading, useStableOrder } from "./useStableOrder";
import { VirtualGrid, type GridColumn, type Line, type VirtualGridProps } from "./VirtualGrid";

export interface Column<T> extends GridColumn<T> {
  /** The value that the column is sorted by; rows with null come last. Without it the column cannot be sorted. */
  sortBy?: (row: T) => string | number | null;
  /** The first click on the heading shows the largest value first. */
  isDescendingFirst?: boolean;
}

export interface Sorting {
  /** The id of a column; "" for the order of the rows as they are. */
  by: string;
  isDescending: boolean;
}

export interface Grouping<T> {
  keyOf: (row: T) => string;
  nameOf: (key: string, count: number) => ReactNode;
}

type Inherited = "label" | "rowHeight" | "isLabelled" | "isCompact" | "selected" | "onSelect" | "nameOf" | "openKey" | "onOpen" | "onEnd" | "children";

export interface DataTableProps<T> extends Pick<VirtualGridProps<T>, Inherited> {
  /** Rows with equal sorting values keep the order they have here. */
  rows: readonly T[];
  columns: readonly Column<T>[];
  keyOf: (row: T) => string;
  sorting: Sorting;
  onSort: (sorting: Sorting) => void;
  grouping?: Grouping<T> | undefined;
  /** Identifies filter and grouping; with another value the rows are shown in their sorted order. */
  view?: string;
  /** The key of a row that this person has just made: once it is there, the sorted order is shown, also while reading. */
  made?: string | undefined;
  /** The newest value of a row that `rows` no longer contains but the table still shows. */
  known?: ReadonlyMap<string, T>;
}

const features = tableFeatures({ rowSortingFeature, sortedRowModel: createSortedRowModel() });
type Features = typeof features;

export function DataTable<T extends object>(props: DataTableProps<T>) {
  const { rows, columns, keyOf, sorting, onSort, grouping, view = "", made, known, ...rest } = props;
  const { t } = useTranslation("common");
  const frame = useRef<HTMLDivElement>(null);
  const { isReading, handlers } = useIsReading();
  const definitions = useMemo(() => columns.map(definitionOf), [columns]);
  const state: SortingState = sorting.by === "" ? [] : [{ id: sorting.by, desc: sorting.isDescending }];
  const table = useTable<Features, T>({
    features,
    columns: definitions,
    data: rows,
    getRowId: keyOf,
    enableSortingRemoval: false,
    enableMultiSort: false,
    state: { sorting: state },
    onSortingChange: (updater: Updater<SortingState>) => {
      const [first] = typeof updater === "function" ? updater(state) : updater;
      if (first !== undefined) onSort({ by: first.id, isDescending: first.desc });
    },
  });
  const sorted = table.getRowModel().rows.map((row) => row.original);
  const byKey = known ?? new Map(rows.map((row) => [keyOf(row), row]));
  const isHeld = isReading || (rest.selected?.size ?? 0) > 0;
  const own = made !== undefined && byKey.has(made) ? made : "";
  const { rows: shown, waiting, release } = useStableOrder(sorted, keyOf, byKey, isHeld, `${view} ${sorting.by} ${sorting.isDescending} ${own}`);
  const showNew = () => {
    release();
    if (frame.current !== null) frame.current.scrollTop = 0;
    frame.current?.querySelector<HTMLElement>('[role="row"][tabindex="0"]')?.focus({ preventScroll: true });
  };
  return (
    <div className="data-table" {...handlers}>
      {waiting > 0 && (
        <div className="data-table__new">
          <Button kind="main" icon={<ArrowUp aria-hidden size={16} />} onPress={showNew}>
            {t("table.new", { count: waiting })}
          </Button>
        </div>
      )}
      <VirtualGrid
        {...rest}
        lines={linesOf(shown, keyOf, grouping)}
        columns={columns}
        frameRef={frame}
        head={table.getFlatHeaders().map((header) => (
          <Heading key={header.id} header={header} name={columns[header.index]?.name ?? ""} isNumber={columns[header.index]?.isNumber ?? false} />
        ))}
      />
    </div>
  );
}

function Heading<T extends object>({ header, name, isNumber }: { header: Header<Features, T>; name: string; isNumber: boolean }) {
  const { column } = header;
  if (!column.getCanSort()) return <div role="columnheader" data-number={isNumber || undefined}>{name}</div>;
  const direction = column.getIsSorted();
  const Arrow = direction === "desc" ? ArrowDown : ArrowUp;
  return (
    <div role="columnheader" data-number={isNumber || undefined} aria-sort={direction === false ? "none" : direction === "desc" ? "descending" : "ascending"}>
      <button type="button" className="vgrid__sort" onClick={() => column.toggleSorting()}>
        {name}
        {direction !== false && <Arrow aria-hidden size={14} />}
      </button>
    </div>
  );
}

function definitionOf<T extends object>(column: Column<T>): ColumnDef<Features, T> {
  const { id, sortBy, isDescendingFirst = false } = column;
  return {
    id,
    accessorFn: (row) => sortBy?.(row) ?? undefined,
    enableSorting: sortBy !== undefined,
    sortDescFirst: isDescendingFirst,
    sortUndefined: "last",
    sortFn: compareValues as SortFn<Features, T>,
  };
}

function compareValues(first: { getValue: (id: string) => unknown }, second: { getValue: (id: string) => unknown }, id: string): number {
  const [a, b] = [first.getValue(id), second.getValue(id)];
  return typeof a === "number" && typeof b === "number" ? a - b : String(a).localeCompare(String(b), undefined, { numeric: true });
}

/** The rows, under the headings of their groups; groups are in the order of their first rows. */
export function linesOf<T>(rows: readonly T[], keyOf: (row: T) => string, grouping?: Grouping<T>): Line<T>[] {
  const line = (row: T): Line<T> => ({ kind: "row", key: keyOf(row), row });
  if (grouping === undefined) return rows.map(line);
  const groups = new Map<string, T[]>();
  for (const row of rows) {
    const members = groups.get(grouping.keyOf(row));
    if (members === undefined) groups.set(grouping.keyOf(row), [row]);
    else members.push(row);
  }
  return [...groups].flatMap(([key, members]) => [
    { kind: "group", key: `group ${key}`, name: grouping.nameOf(key, members.length) } as const,
    ...members.map(line),
  ]);
}
