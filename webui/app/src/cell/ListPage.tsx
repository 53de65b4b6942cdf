/** A page of Cell that shows all objects of one kind, or what happened. */
import type { ReactNode } from "react";
import { useTranslation } from "react-i18next";
import "./Cell.css";

export function ListPage({ name, children }: { name: string; children: ReactNode }) {
  const { t } = useTranslation("common");
  return (
    <div className="cell-page">
      <h1 className="visually-hidden">{t(`pages.${name}`)}</h1>
      {children}
    </div>
  );
}
