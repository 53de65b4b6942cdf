/**
 * A grid of any length. Only the visible rows are in the document. The grid is one tab stop: the arrow keys move
 * between rows, Space selects a row, Enter opens it. On a narrow screen each row is a card.
 */
import { defaultRangeExtractor, useVirtualizer, type Range } from "@tanstack/react-virtual";
import { useCallback, useEffect, useLayoutEffect, useRef, useState, type CSSProperties, type KeyboardEvent, type MouseEvent, type ReactNode, type Ref } from "react";
import { useTranslation } from "react-i18next";
import "./VirtualGrid.css";

/** A line of the grid: a row, or the heading of the rows that follow. */
export type Line<T> = { kind: "row"; key: string; row: T } | { kind: "group"; key: string; name: ReactNode };

export interface GridColumn<T> {
  id: string;
  name: string;
  /** A track of a CSS grid: "minmax(120px, 2fr)". */
  width: string;
  /** Numbers are aligned to the right. */
  isNumber?: boolean;
  cell: (row: T) => ReactNode;
}

export interface VirtualGridProps<T> {
  label: string;
  lines: readonly Line<T>[];
  columns: readonly GridColumn<T>[];
  /** The usual height of a row in px, used until the row is measured. */
  rowHeight: number;
  /** The cells of the heading row; without it the grid shows no column names. */
  head?: ReactNode;
  /** On a narrow screen the cells of a card show the names of their columns. */
  isLabelled?: boolean;
  /** Few, narrow columns: rows become cards when the section around the grid is narrow, not the grid itself. */
  isCompact?: boolean;
  selected?: ReadonlySet<string>;
  onSelect?: (selected: ReadonlySet<string>) => void;
  /** The name of a row for screen readers and for its checkbox. */
  nameOf?: (row: T) => string;
  /** The row whose details the page shows. */
  openKey?: string | null;
  onOpen?: (row: T) => void;
  /** Called when the last rows come into view. */
  onEnd?: (() => void) | undefined;
  frameRef?: Ref<HTMLDivElement>;
  /** Shown below the rows, in the scrolled area. */
  children?: ReactNode;
}

const PAGE_ROWS = 10;

export function VirtualGrid<T>(props: VirtualGridProps<T>) {
  const { label, lines, columns, rowHeight, head, isLabelled = false, isCompact = false, selected, onSelect, openKey, onOpen, nameOf, onEnd, frameRef, children } = props;
  const { t } = useTranslation("common");
  const frame = useRef<HTMLDivElement>(null);
  const headRow = useRef<HTMLDivElement>(null);
  const [activeKey, setActiveKey] = useState<string | null>(null);
  // The key of the row to focus. A flag would not do: the effects of an earlier render can run after a key was
  // pressed and before the row it moves to is marked active, and would use up the flag for the previous row.
  const focusKey = useRef<string | null>(null);
  const rangeStart = useRef<string | null>(null);

  const firstRow = lines.findIndex((line) => line.kind === "row");
  const activeIndex = lines.findIndex((line) => line.kind === "row" && line.key === activeKey);
  const active = activeIndex === -1 ? firstRow : activeIndex;
  // The row that Tab reaches stays in the document when it is scrolled out of view.
  const rangeExtractor = useCallback(
    (range: Range) => {
      const visible = defaultRangeExtractor(range);
      return active < 0 || visible.includes(active) ? visible : [...visible, active].sort((a, b) => a - b);
    },
    [active],
  );
  // eslint-disable-next-line react-hooks/incompatible-library -- no memoized child uses its functions
  const virtualizer = useVirtualizer({
    count: lines.length,
    getScrollElement: () => frame.current,
    estimateSize: (index) => (lines[index]?.kind === "group" ? 36 : rowHeight),
    getItemKey: (index) => lines[index]?.key ?? index,
    overscan: 6,
    rangeExtractor,
  });

  useLayoutEffect(() => {
    const row = frame.current?.querySelector<HTMLElement>('[role="row"][tabindex="0"]');
    if (row == null || focusKey.current === null || row.dataset["key"] !== focusKey.current) return;
    focusKey.current = null;
    row.focus({ preventScroll: true });
  });

  // Columns stay in line beside a scrollbar of the rows.
  useLayoutEffect(() => {
    const body = frame.current;
    if (body !== null && headRow.current !== null) headRow.current.style.paddingInlineEnd = `${body.offsetWidth - body.clientWidth}px`;
  });

  // The open row is in view when the page is loaded from a link.
  const openIndex = openKey == null ? -1 : lines.findIndex((line) => line.key === openKey);
  const isOpenFound = openIndex !== -1;
  useEffect(() => {
    if (isOpenFound) virtualizer.scrollToIndex(openIndex, { align: "auto" });
    // eslint-disable-next-line react-hooks/exhaustive-deps -- a row that is moved later must not scroll the table
  }, [openKey, isOpenFound]);

  const lastVisible = virtualizer.getVirtualItems().at(-1)?.index ?? 0;
  const isAtEnd = lastVisible >= lines.length - 3;
  useEffect(() => {
    if (isAtEnd) onEnd?.();
  });

  const moveTo = (index: number) => {
    const line = lines[index];
    if (line?.kind !== "row") return;
    focusKey.current = line.key;
    setActiveKey(line.key);
    virtualizer.scrollToIndex(index);
  };
  const next = (from: number, step: 1 | -1) => {
    let index = from + step;
    while (lines[index]?.kind === "group") index += step;
    return index;
  };
  const rowKeys = lines.filter((line) => line.kind === "row").map((line) => line.key);
  /** Select or deselect a row; with Shift, all rows since the last one that was selected. */
  const toggle = (key: string, isRange: boolean) => {
    if (selected === undefined) return;
    const isSelecting = !selected.has(key);
    const [start, end] = [rowKeys.indexOf(isRange ? (rangeStart.current ?? key) : key), rowKeys.indexOf(key)];
    const after = new Set(selected);
    for (const each of rowKeys.slice(Math.max(0, Math.min(start, end)), Math.max(start, end) + 1)) {
      if (isSelecting) after.add(each);
      else after.delete(each);
    }
    rangeStart.current = key;
    onSelect?.(after);
  };
  const onKeyDown = (event: KeyboardEvent) => {
    const line = lines[active];
    if ((event.target as HTMLElement).closest('[role="row"]') !== event.target || line?.kind !== "row") return;
    if (event.key === "ArrowDown") moveTo(next(active, 1));
    else if (event.key === "ArrowUp") moveTo(next(active, -1));
    else if (event.key === "PageDown") moveTo(Math.min(lines.length - 1, active + PAGE_ROWS));
    else if (event.key === "PageUp") moveTo(Math.max(firstRow, active - PAGE_ROWS));
    else if (event.key === "Home") moveTo(firstRow);
    else if (event.key === "End") moveTo(lines.length - 1);
    else if (event.key === " " && selected !== undefined) toggle(line.key, event.shiftKey);
    else if (event.key === "Enter" && onOpen !== undefined) onOpen(line.row);
    else if (event.key === "a" && (event.ctrlKey || event.metaKey) && selected !== undefined) onSelect?.(new Set(rowKeys));
    else return;
    event.preventDefault();
  };

  const template = `${selected === undefined ? "" : "36px "}${columns.map((column) => column.width).join(" ")}`;
  const style: CSSProperties & Record<"--columns", string> = { "--columns": template };
  const hasHead = head !== undefined;
  return (
    <div className="vgrid" data-labelled={isLabelled || undefined} data-compact={isCompact || undefined} role="grid" aria-label={label} aria-rowcount={lines.length + (hasHead ? 1 : 0)} aria-multiselectable={selected === undefined ? undefined : true} style={style}>
      {hasHead && (
        <div ref={headRow} role="rowgroup" className="vgrid__head">
          <div role="row" aria-rowindex={1} className="vgrid__row">
            {selected !== undefined && <SelectAll keys={rowKeys} selected={selected} {...(onSelect === undefined ? {} : { onSelect })} />}
            {head}
          </div>
        </div>
      )}
      <div
        ref={(element) => {
          frame.current = element;
          if (typeof frameRef === "function") frameRef(element);
          else if (frameRef != null) frameRef.current = element;
        }}
        role="rowgroup"
        className="vgrid__body"
        onKeyDown={onKeyDown}
      >
        <div role="presentation" className="vgrid__space" style={{ height: virtualizer.getTotalSize() }}>
          {virtualizer.getVirtualItems().map((item) => {
            const line = lines[item.index];
            if (line === undefined) return null;
            const position = { transform: `translateY(${item.start}px)` };
            const rowIndex = item.index + (hasHead ? 2 : 1);
            if (line.kind === "group") {
              return (
                <div key={item.key} ref={virtualizer.measureElement} data-index={item.index} role="row" aria-rowindex={rowIndex} className="vgrid__group" style={position}>
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
                data-openable={onOpen !== undefined || undefined}
                role="row"
                aria-rowindex={rowIndex}
                aria-selected={selected === undefined ? (openKey === undefined ? undefined : isOpen) : isSelected}
                aria-label={nameOf?.(line.row)}
                tabIndex={item.index === active ? 0 : -1}
                className="vgrid__row vgrid__line"
                style={position}
                onFocus={() => setActiveKey(line.key)}
                onClick={(event) => {
                  if ((event.target as HTMLElement).closest("input, a, button") === null) onOpen?.(line.row);
                }}
              >
                {selected !== undefined && (
                  <div role="gridcell" className="vgrid__box">
                    <input
                      type="checkbox"
                      tabIndex={-1}
                      aria-label={t("table.select", { name: nameOf?.(line.row) ?? line.key })}
                      checked={isSelected}
                      onChange={(event) => toggle(line.key, (event.nativeEvent as unknown as MouseEvent).shiftKey)}
                    />
                  </div>
                )}
                {columns.map((column) => (
                  <div key={column.id} role="gridcell" className={`vgrid__cell vgrid__cell--${column.id}`} data-label={column.name} data-number={column.isNumber === true || undefined}>
                    {column.cell(line.row)}
                  </div>
                ))}
              </div>
            );
          })}
        </div>
        {children != null && children !== false && (
          <div role="row">
            <div role="gridcell">{children}</div>
          </div>
        )}
      </div>
    </div>
  );
}

function SelectAll({ keys, selected, onSelect }: { keys: readonly string[]; selected: ReadonlySet<string>; onSelect?: (selected: ReadonlySet<string>) => void }) {
  const { t } = useTranslation("common");
  const isAll = keys.length > 0 && keys.every((key) => selected.has(key));
  return (
    <div role="columnheader" className="vgrid__box">
      <input
        type="checkbox"
        aria-label={t("table.selectAll")}
        checked={isAll}
        ref={(box) => {
          if (box !== null) box.indeterminate = !isAll && selected.size > 0;
        }}
        onChange={() => onSelect?.(new Set(isAll ? [] : keys))}
      />
    </div>
  );
}
