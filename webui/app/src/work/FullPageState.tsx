/** A full-page state: the event, its effect on the work and the remedy. */
import type { ReactNode } from "react";
import type { Tone } from "~/design/StatusBadge";
import "./FullPageState.css";

export interface FullPageStateProps {
  tone: Tone;
  icon: ReactNode;
  title: string;
  means?: string | undefined;
  todo?: string | undefined;
  /** The text of the service. */
  detail?: string | null | undefined;
  children?: ReactNode;
}

export function FullPageState({ tone, icon, title, means, todo, detail, children }: FullPageStateProps) {
  return (
    <section className={`full-page-state full-page-state--${tone}`} role={tone === "stop" ? "alert" : "status"}>
      <div className="full-page-state__icon">{icon}</div>
      <div className="full-page-state__text">
        <h1>{title}</h1>
        {means !== undefined && <p>{means}</p>}
        {todo !== undefined && <p className="full-page-state__action">{todo}</p>}
        {detail != null && detail !== "" && <p className="full-page-state__detail">{detail}</p>}
        {children !== undefined && <div className="full-page-state__actions">{children}</div>}
      </div>
    </section>
  );
}
