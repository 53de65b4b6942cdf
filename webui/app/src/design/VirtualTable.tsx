/**
 * A table of any length: only the rows visible are in the document. It is one tab stop; the arrow keys move
 * between rows, Space selects and Enter opens one. On a narrow screen a row is a card without columns.
 */
import { defaultRangeExtractor, useVirtualizer, type Range } from "@tanstack/react-virtual";
import { ArrowDown, ArrowUp } from "lucide-react";
import { useCallback, useEffect, useRef, useState, type KeyboardEvent, type ReactNode } from "react";
import { useTranslation } from "react-i18next";
import "./VirtualTable.css";

export interface Column<T> {
  id: string;
  name: string;
  /** A track of a CSS grid: "minmax(120px, 2fr)". */
  width: string;
  isSortable?: boolean;
  cell: (row: T) => ReactNode;
}

/** What stands in a line: a row, or the head of the group of rows that follow. */
export type Line<T> = { kind: "row"; key: string; row: T } | { kind: "group"; key: string; name: ReactNode };

export interface Sorting {
  by: string;
  isDescending: boolean;
}

export interface VirtualTableProps<T> {
  label: string;
  lines: readonly Line<T>[];
  columns: readonly Column<T>[];
  /** The usual height of a row in px, before it has been measured. */
  rowHeight: number;
  /** Without a head the columns have no names on the screen. */
  hasHead?: boolean;
  sorting?: Sorting;
  onSort?: (sorting: Sorting) => void;
  selected?: ReadonlySet<string>;
  onSelect?: (selected: ReadonlySet<string>) => void;
  /** What a row is called, for its box and for screen readers. */
  nameOf?: (row: T) => string;
  /** The row that is open elsewhere on the page. */
  openKey?: string | null;
  onOpen?: (row: T) => void;
  /** Called when the last rows come into view. */
  onEnd?: (() => void) | undefined;
  children?: ReactNode;
}

export function VirtualTable<T>(props: VirtualTableProps<T>) {
  const { label, lines, columns, rowHeight, hasHead = true, selected, onSelect, openKey, onOpen, nameOf, onEnd, children } = props;
  const { t } = useTranslation("common");
  const frame = useRef<HTMLDivElement>(null);
  const [activeKey, setActiveKey] = useState<string | null>(null);
  const wantsFocus = useRef(false);

  const firstRow = lines.findIndex((line) => line.kind === "row");
  const found = lines.findIndex((line) => line.kind === "row" && line.key === activeKey);
  const active = found === -1 ? firstRow : found;
  // The row that Tab reaches is in the document even when it is scrolled out of view.
  const rangeExtractor = useCallback(
    (range: Range) => {
      const scrollIntoView = defaultRangeExtractor(range);
      return active < 0 || scrollIntoView.includes(active) ? scrollIntoView : [...scrollIntoView, active].sort((a, b) => a - b);
    },
    [active],
  );
  // eslint-disable-next-line react-hooks/incompatible-library -- its functions are used in this component alone
  const virtualizer = useVirtualizer({
    count: lines.length,
    getScrollElement: () => frame.current,
    estimateSize: (index) => (lines[index]?.kind === "group" ? 36 : rowHeight),
    getItemKey: (index) => lines[index]?.key ?? index,
    overscan: 6,
    rangeExtractor,
  });

  useEffect(() => {
    if (!wantsFocus.current) return;
    const row = frame.current?.querySelector<HTMLElement>('[role="row"][tabindex="0"]');
    if (row == null) return;
    wantsFocus.current = false;
    row.focus({ preventScroll: true });
  });

  const lastVisible = virtualizer.getVirtualItems().at(-1)?.index ?? 0;
  const isAtEnd = lastVisible >= lines.length - 3;
  useEffect(() => {
    if (isAtEnd) onEnd?.();
  });

  const goTo = (index: number) => {
    const line = lines[index];
    if (line?.kind !== "row") return;
    wantsFocus.current = true;
    setActiveKey(line.key);
    virtualizer.scrollToIndex(index);
  };
  const next = (from: number, step: 1 | -1) => {
    let index = from + step;
    while (lines[index]?.kind === "group") index += step;
    return index;
  };
  const toggle = (key: string) => {
    if (selected === undefined) return;
    const after = new Set(selected);
    if (!after.delete(key)) after.add(key);
    onSelect?.(after);
  };
  const rowKeys = lines.filter((line) => line.kind === "row").map((line) => line.key);
  const isAll = rowKeys.length > 0 && selected !== undefined && rowKeys.every((key) => selected.has(key));
  const onKeyDown = (event: KeyboardEvent) => {
    const line = lines[active];
    if ((event.target as HTMLElement).closest('[role="row"]') !== event.target || line?.kind !== "row") return;
    if (event.key === "ArrowDown") goTo(next(active, 1));
    else if (event.key === "ArrowUp") goTo(next(active, -1));
    else if (event.key === "PageDown") goTo(Math.min(lines.length - 1, active + 10));
    else if (event.key === "PageUp") goTo(Math.max(firstRow, active - 10));
    else if (event.key === "Home") goTo(firstRow);
    else if (event.key === "End") goTo(lines.length - 1);
    else if (event.key === " " && selected !== undefined) toggle(line.key);
    else if (event.key === "Enter" && onOpen !== undefined) onOpen(line.row);
    else if (event.key === "a" && (event.ctrlKey || event.metaKey) && selected !== undefined) onSelect?.(new Set(rowKeys));
    else return;
    event.preventDefault();
  };

  const template = `${selected === undefined ? "" : "36px "}${columns.map((column) => column.width).join(" ")}`;
  const style = { "--columns": template } as React.CSSProperties;
  return (
    <div className="vtable" role="grid" aria-label={label} aria-rowcount={lines.length + (hasHead ? 1 : 0)} aria-multiselectable={selected === undefined ? undefined : true} style={style}>
      {hasHead && (
        <div role="rowgroup" className="vtable__head">
          <div role="row" aria-rowindex={1} className="vtable__row">
            {selected !== undefined && (
              <div role="columnheader" className="vtable__box">
                <input
                  type="checkbox"
                  aria-label={t("table.selectAll")}
                  checked={isAll}
                  ref={(box) => {
                    if (box !== null) box.indeterminate = !isAll && selected.size > 0;
                  }}
                  onChange={() => onSelect?.(new Set(isAll ? [] : rowKeys))}
                />
              </div>
            )}
            {columns.map((column) => (
              <Head key={column.id} column={column} {...(props.sorting === undefined ? {} : { sorting: props.sorting })} {...(props.onSort === undefined ? {} : { onSort: props.onSort })} />
            ))}
          </div>
        </div>
      )}
      <div ref={frame} role={lines.length > 0 ? "rowgroup" : "presentation"} className="vtable__body" onKeyDown={onKeyDown}>
        <div role="presentation" className="vtable__space" style={{ height: virtualizer.getTotalSize() }}>
          {virtualizer.getVirtualItems().map((item) => {
            const line = lines[item.index];
            if (line === undefined) return null;
            const place = { transform: `translateY(${item.start}px)` };
            const rowIndex = item.index + (hasHead ? 2 : 1);
            if (line.kind === "group") {
              return (
                <div key={item.key} ref={virtualizer.measureElement} data-index={item.index} role="row" aria-rowindex={rowIndex} className="vtable__group" style={place}>
                  <div role="gridcell">{line.name}</div>
                </div>
              );
            }
            const isSelected = selected?.has(line.key) ?? false;
            const isOpen = openKey === line.key;
            return (
              <div
                key={item.key}
                ref={virtualizer.measureElement}
                data-index={item.index}
                data-key={line.key}
                data-open={isOpen || undefined}
                role="row"
                aria-rowindex={rowIndex}
                aria-selected={selected === undefined ? (openKey === undefined ? undefined : isOpen) : isSelected}
                aria-label={nameOf?.(line.row)}
                tabIndex={item.index === active ? 0 : -1}
                className="vtable__row vtable__line"
                style={place}
                onFocus={() => setActiveKey(line.key)}
                onClick={(event) => {
                  if ((event.target as HTMLElement).closest("input, a, button") === null) onOpen?.(line.row);
                }}
              >
                {selected !== undefined && (
                  <div role="gridcell" className="vtable__box">
                    <input
                      type="checkbox"
                      tabIndex={-1}
                      aria-label={t("table.select", { name: nameOf?.(line.row) ?? line.key })}
                      checked={isSelected}
                      onChange={() => toggle(line.key)}
                    />
                  </div>
                )}
                {columns.map((column) => (
                  <div key={column.id} role="gridcell" className={`vtable__cell vtable__cell--${column.id}`} data-label={column.name}>
                    {column.cell(line.row)}
                  </div>
                ))}
              </div>
            );
          })}
        </div>
        {children}
      </div>
    </div>
  );
}

function Head<T>({ column, sorting, onSort }: { column: Column<T>; sorting?: Sorting; onSort?: (sorting: Sorting) => void }) {
  if (column.isSortable !== true || onSort === undefined) return <div role="columnheader">{column.name}</div>;
  const isSorted = sorting?.by === column.id;
  const isDescending = isSorted && sorting.isDescending;
  const Arrow = isDescending ? ArrowDown : ArrowUp;
  return (
    <div role="columnheader" aria-sort={isSorted ? (isDescending ? "descending" : "ascending") : "none"}>
      <button type="button" className="vtable__sort" onClick={() => onSort({ by: column.id, isDescending: isSorted ? !isDescending : true })}>
        {column.name}
        {isSorted && <Arrow aria-hidden size={14} />}
      </button>
    </div>
  );
}
