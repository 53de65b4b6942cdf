/** An empty place says what would be here and offers the one act that fills it. */
import type { ReactNode } from "react";
import "./Empty.css";

export function Empty({ icon, title, children, act }: { icon?: ReactNode; title: string; children?: ReactNode; act?: ReactNode }) {
  return (
    <div className="empty">
      {icon}
      <p className="empty__title">{title}</p>
      {children !== undefined && <div className="quiet">{children}</div>}
      {act}
    </div>
  );
}
