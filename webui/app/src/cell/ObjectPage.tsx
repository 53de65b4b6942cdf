/** The page of one object of the cell: its name, a choice of the others, and its tabs, each with an address. */
import { ArrowLeft } from "lucide-react";
import type { ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { Link, useLocation } from "wouter";
import { Select } from "~/design/Select";
import "./Cell.css";

interface ObjectPageProps<Tab extends string> {
  /** The name of the list in `common:pages`, and its address. */
  list: { name: string; address: string };
  name: string;
  /** The names of all objects of this kind. */
  names: readonly string[];
  tab: Tab;
  tabs: readonly Tab[];
  addressOf: (name: string, tab: Tab) => string;
  children: ReactNode;
}

export function ObjectPage<Tab extends string>({ list, name, names, tab, tabs, addressOf, children }: ObjectPageProps<Tab>) {
  const { t } = useTranslation("common");
  const [, go] = useLocation();
  return (
    <div className="cell-page">
      <header className="cell-page__head">
        <Link href={list.address} aria-label={t("backTo", { page: t(`pages.${list.name}`) })} className="shell__page">
          <ArrowLeft aria-hidden size={18} />
        </Link>
        <h1>{name}</h1>
        {names.length > 1 && (
          <Select label={t(`pages.${list.name}`)} value={name} options={names.map((other) => ({ value: other, name: other }))} onChange={(other) => go(addressOf(other, tab))} />
        )}
        {tabs.length > 1 && (
          <nav className="cell-page__tabs" aria-label={name}>
            {tabs.map((other) => (
              <Link key={other} href={addressOf(name, other)} className="cell-page__tab" aria-current={other === tab ? "page" : undefined}>
                {t(`objectTab.${other}`)}
              </Link>
            ))}
          </nav>
        )}
      </header>
      {children}
    </div>
  );
}
