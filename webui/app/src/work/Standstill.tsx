/** A state of the whole page: what has happened, what it means for the work, what to do. */
import type { ReactNode } from "react";
import type { Tone } from "~/design/State";
import "./Standstill.css";

export interface StandstillProps {
  tone: Tone;
  icon: ReactNode;
  title: string;
  means?: string | undefined;
  todo?: string | undefined;
  /** In the service's own words. */
  detail?: string | null | undefined;
  children?: ReactNode;
}

export function Standstill({ tone, icon, title, means, todo, detail, children }: StandstillProps) {
  return (
    <section className={`standstill standstill--${tone}`} role={tone === "stop" ? "alert" : "status"}>
      <div className="standstill__icon">{icon}</div>
      <div className="standstill__words">
        <h1>{title}</h1>
        {means !== undefined && <p>{means}</p>}
        {todo !== undefined && <p className="standstill__do">{todo}</p>}
        {detail != null && detail !== "" && <p className="standstill__detail">{detail}</p>}
        {children !== undefined && <div className="standstill__acts">{children}</div>}
      </div>
    </section>
  );
}
