/**
 * Rows: a table on a wide screen, cards where it is narrow; the roles are stated, because CSS would take them away.
 * It is one tab stop: the arrow keys move between the rows, and a row with the focus shows its exact times.
 */
import { useState, type KeyboardEvent, type ReactNode } from "react";

export interface RowsProps {
  label: string;
  heads: readonly string[];
  /** Of the columns, so that none moves because of what comes to stand in it. */
  widths: readonly string[];
  children: ReactNode;
}

const steps: Record<string, (at: number, last: number) => number> = {
  ArrowDown: (at, last) => Math.min(at + 1, last),
  ArrowUp: (at) => Math.max(at - 1, 0),
  Home: () => 0,
  End: (_, last) => last,
};

export function Rows({ label, heads, widths, children }: RowsProps) {
  const onKeyDown = (event: KeyboardEvent<HTMLElement>) => {
    const rows = [...event.currentTarget.querySelectorAll<HTMLElement>(":scope > [role=row]")];
    const at = rows.indexOf(event.target as HTMLElement);
    const step = steps[event.key];
    if (at === -1 || step === undefined) return;
    event.preventDefault();
    rows[step(at, rows.length - 1)]?.focus();
  };
  return (
    <table className="rows" role="table" aria-label={label}>
      <thead role="rowgroup">
        <tr role="row">
          {heads.map((head, column) => (
            <th key={head} role="columnheader" scope="col" style={{ width: widths[column] }}>
              {head}
            </th>
          ))}
        </tr>
      </thead>
      <tbody role="rowgroup" onKeyDown={onKeyDown}>
        {children}
      </tbody>
    </table>
  );
}

/** `isFirst`: the row that Tab reaches as long as none has had the focus. */
export function Row({ isFirst, children }: { isFirst: boolean; children: ReactNode }) {
  const [isHere, setHere] = useState(false);
  return (
    <tr role="row" tabIndex={isFirst || isHere ? 0 : -1} onFocus={() => setHere(true)} onBlur={() => setHere(false)}>
      {children}
    </tr>
  );
}

export function Cell({ head, children }: { head: string; children?: ReactNode }) {
  return (
    <td role="cell" data-label={head}>
      {children != null && children !== false && <div>{children}</div>}
    </td>
  );
}
