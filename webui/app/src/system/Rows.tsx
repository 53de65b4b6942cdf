/** Rows: a table on a wide screen, cards on a phone; the roles are said, because CSS would take them away. */
import type { ReactNode } from "react";

export interface RowsProps {
  label: string;
  heads: readonly string[];
  /** Of the columns, so that none moves because of what comes to stand in it. */
  widths: readonly string[];
  children: ReactNode;
}

export function Rows({ label, heads, widths, children }: RowsProps) {
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
      <tbody role="rowgroup">{children}</tbody>
    </table>
  );
}

export function Row({ children }: { children: ReactNode }) {
  return <tr role="row">{children}</tr>;
}

export function Cell({ head, children }: { head: string; children?: ReactNode }) {
  return (
    <td role="cell" data-label={head}>
      {children != null && children !== false && <div>{children}</div>}
    </td>
  );
}
