/** Rows: a table on a wide screen, cards on a phone; the roles are said, because CSS would take them away. */
import type { ReactNode } from "react";

export function Rows({ label, heads, children }: { label: string; heads: readonly string[]; children: ReactNode }) {
  return (
    <table className="rows" role="table" aria-label={label}>
      <thead role="rowgroup">
        <tr role="row">
          {heads.map((head) => (
            <th key={head} role="columnheader" scope="col">
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
