/** Columns of numbers and durations, and bars that show parts of a whole. */
import { useMemo } from "react";
import { useTranslation } from "react-i18next";
import type { Column } from "~/design/table/DataTable";
import { number } from "~/design/numbers";
import { duration } from "~/design/times";

/** Columns over members of a row that are numbers or null; the largest first. */
/** From how many values a percentile says something. */
export const MIN_COMPLETED = { medianMs: 3, p90Ms: 10 } as const;

export function hasEnough(name: string, completed: number | undefined): boolean {
  return !(name in MIN_COMPLETED) || completed === undefined || completed >= MIN_COMPLETED[name as keyof typeof MIN_COMPLETED];
}

export function useFigureColumns<T extends object>() {
  const { i18n } = useTranslation("cockpit");
  return useMemo(() => {
    const column = (id: keyof T & string, name: string, said: (value: number) => string): Column<T> => {
      const of = (row: T) => (typeof row[id] === "number" ? (row[id] as number) : null);
      const cell = (row: T) => {
        const value = of(row);
        return <span>{value === null ? "–" : said(value)}</span>;
      };
      return { id, name, width: "minmax(72px, 0.8fr)", isNumber: true, isDescendingFirst: true, sortBy: of, cell };
    };
    return {
      count: (id: keyof T & string, name: string) => column(id, name, (value) => number(value, i18n.language)),
      time: (id: keyof T & string, name: string) => column(id, name, (value) => duration(value, i18n.language)),
      /** A percentile, where enough is completed to say one. */
      percentile: (id: keyof T & (keyof typeof MIN_COMPLETED), name: string): Column<T> => {
        const whole = column(id, name, (value) => duration(value, i18n.language));
        const isEnough = (row: T) => hasEnough(id, (row as { completed?: number }).completed);
        return { ...whole, sortBy: (row) => (isEnough(row) ? (whole.sortBy?.(row) ?? null) : null), cell: (row) => (isEnough(row) ? whole.cell(row) : <span>–</span>) };
      },
    };
  }, [i18n.language]);
}

export interface Part {
  kind: "waiting" | "working" | "paused" | "used";
  share: number;
  title: string;
}

/** A bar whose parts are shares of its width; the title says them, so that colour is not all. */
export function Bar({ parts }: { parts: readonly Part[] }) {
  const title = parts.map((part) => part.title).join(", ");
  return (
    <span className="bar" role="img" aria-label={title} title={title}>
      {parts.map(({ kind, share }) => (
        <span key={kind} className={`bar__part bar__part--${kind}`} style={{ width: `${Math.min(1, Math.max(0, share)) * 100}%` }} />
      ))}
    </span>
  );
}
