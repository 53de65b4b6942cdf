/** An empty place says what would be here and offers the one act that fills it. */
import type { ReactNode } from "react";
import "./EmptyState.css";

export function EmptyState({ icon, title, children, act }: { icon?: ReactNode; title: string; children?: ReactNode; act?: ReactNode }) {
  return (
    <div className="empty-state">
      {icon}
      <p className="empty-state__title">{title}</p>
      {children !== undefined && <div className="quiet">{children}</div>}
      {act}
    </div>
  );
}
