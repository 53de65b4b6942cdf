/** A card with a title. */
import { useId, type ReactNode } from "react";
import "./Card.css";

export interface CardProps {
  title?: ReactNode;
  /** Shown to the right of the title: a state, a button. */
  aside?: ReactNode;
  children: ReactNode;
  className?: string;
}

export function Card({ title, aside, children, className }: CardProps) {
  const id = useId();
  return (
    <section className={className === undefined ? "card" : `card ${className}`} {...(title === undefined ? {} : { "aria-labelledby": id })}>
      {title !== undefined && (
        <header className="card__head">
          <h2 id={id}>{title}</h2>
          {aside}
        </header>
      )}
      {children}
    </section>
  );
}
