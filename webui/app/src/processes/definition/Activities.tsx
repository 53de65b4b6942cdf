/** The activities of a definition as a table: their lanes, counts and durations. */
import { useMemo } from "react";
import { useTranslation } from "react-i18next";
import type { ActivityAllocation, DefinitionActivity, ElementCounts } from "~/api/generated/task-orchestrator";
import { StatusBadge } from "~/design/StatusBadge";
import { DataTable, type Column } from "~/design/table/DataTable";
import { useSorting } from "~/design/table/useSorting";
import { duration } from "~/design/times";
import { localizedText } from "~/i18n/server";

export interface ActivitiesProps {
  activities: readonly DefinitionActivity[];
  counts: Readonly<Record<string, ElementCounts>>;
  allocation: readonly ActivityAllocation[];
  onPick: (element: string) => void;
}

export function Activities({ activities, counts, allocation, onPick }: ActivitiesProps) {
  const { t } = useTranslation("processes");
  const [sorting, setSorting] = useSorting("", "activitySort");
  return (
    <DataTable
      label={t("activities.label")}
      rows={activities}
      columns={useColumns(counts, allocation)}
      keyOf={(activity) => activity.id}
      nameOf={nameOf}
      rowHeight={56}
      sorting={sorting}
      onSort={setSorting}
      onOpen={(activity) => onPick(activity.id)}
    />
  );
}

function nameOf(activity: DefinitionActivity): string {
  return activity.name === "" ? activity.id : activity.name;
}

function useColumns(counts: ActivitiesProps["counts"], allocation: ActivitiesProps["allocation"]): readonly Column<DefinitionActivity>[] {
  const { t, i18n } = useTranslation("processes");
  return useMemo(() => {
    const performers = new Map(allocation.map((line) => [line.element, line]));
    const count = (id: "running" | "completed" | "failed"): Column<DefinitionActivity> => {
      const of = (activity: DefinitionActivity) => counts[activity.id]?.[id] ?? 0;
      return { id, name: t(`activities.${id}`), width: "minmax(84px, 0.7fr)", isNumber: true, isDescendingFirst: true, sortBy: of, cell: of };
    };
    const time = (id: "last" | "median", member: "lastMs" | "medianMs"): Column<DefinitionActivity> => {
      const of = (activity: DefinitionActivity) => counts[activity.id]?.[member] ?? null;
      const cell = (activity: DefinitionActivity) => {
        const ms = of(activity);
        return ms === null ? "–" : duration(ms, i18n.language);
      };
      return { id, name: t(`activities.${id}`), width: "minmax(84px, 0.8fr)", isNumber: true, isDescendingFirst: true, sortBy: of, cell };
    };
    return [
      { id: "name", name: t("activities.name"), width: "minmax(160px, 2fr)", sortBy: nameOf, cell: (activity) => <strong>{nameOf(activity)}</strong> },
      {
        id: "performer", name: t("activities.performer"), width: "minmax(150px, 1.8fr)",
        sortBy: (activity) => performers.get(activity.id)?.performer ?? null,
        cell: (activity) => <Performer line={performers.get(activity.id)} />,
      },
      { id: "lane", name: t("activities.lane"), width: "minmax(90px, 1fr)", sortBy: (activity) => activity.lane, cell: (activity) => activity.lane },
      count("running"),
      count("completed"),
      count("failed"),
      time("last", "lastMs"),
      time("median", "medianMs"),
    ];
  }, [t, i18n.language, counts, allocation]);
}

/** Who gets an activity now, with a warning if nobody can. */
export function Performer({ line }: { line: ActivityAllocation | undefined }) {
  const { t } = useTranslation("processes");
  if (line === undefined) return <span>–</span>;
  const warning = localizedText(line, "warning");
  const performer = line.performer ?? t("activities.people");
  return (
    <>
      <span title={localizedText(line, "reason") ?? ""}>{performer}</span>
      {warning !== null && (
        <p>
          <StatusBadge tone="attention">{warning}</StatusBadge>
        </p>
      )}
    </>
  );
}
