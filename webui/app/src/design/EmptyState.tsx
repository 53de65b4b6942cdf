/** The text and the action of a page or table without content. */
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
