/** A section of Home: a card with a list, what is said when it is empty, and a link to all of it. */
import type { ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import type { ProcessView } from "~/api/generated/task-orchestrator";
import { Card } from "~/design/Card";
import { exactTime } from "~/design/times";
import { addresses } from "~/places/addresses";

/** Each list shows this many entries and a link to the rest. */
export const MAX_LISTED = 6;

interface SectionProps<T> {
  title: string;
  all: readonly T[];
  href: string;
  none: ReactNode;
  lead?: ReactNode;
  max?: number;
  children: (item: T) => ReactNode;
}

export function Section<T>({ title, all, href, none, lead, max = MAX_LISTED, children }: SectionProps<T>) {
  return (
    <Card className="home__section" title={title} aside={<span className="home__count">{all.length}</span>}>
      {all.length === 0 && <p className="quiet">{none}</p>}
      {lead}
      <ul className="home__list">{all.slice(0, max).map(children)}</ul>
      <More count={all.length - max} href={href} />
    </Card>
  );
}

export function More({ count, href }: { count: number; href: string }) {
  const { t } = useTranslation("home");
  return count > 0 && <Link href={href}>{t("more", { count })}</Link>;
}

/** A process by its name, never by its id alone. */
export function ProcessName({ process }: { process: ProcessView }) {
  const { i18n } = useTranslation();
  return (
    <Link href={addresses.process(process.id)} title={exactTime(process.startedAt, i18n.language)}>
      {process.name}
    </Link>
  );
}
