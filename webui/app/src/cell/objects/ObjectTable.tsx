/** Objects of the cell as a table: what each is, its state, what it does now, and its Alerts. A row opens the page of its object. */
import { Activity, Bot, Box, Hand, SearchX } from "lucide-react";
import { useMemo, type ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { Link, useLocation } from "wouter";
import { EmptyState } from "~/design/EmptyState";
import { RelativeTime } from "~/design/RelativeTime";
import { StatusBadge } from "~/design/StatusBadge";
import { DataTable, type Column, type Grouping } from "~/design/table/DataTable";
import { useSorting } from "~/design/table/useSorting";
import { KindIcon } from "~/devices/KindIcon";
import { addresses } from "~/places/addresses";
import { Battery } from "../Battery";
import type { CellObject, ObjectKind } from "./cellObjects";
import { ObjectState } from "./ObjectState";
import { useNowText } from "./useNowText";
import "./ObjectTable.css";

interface ObjectTableProps {
  label: string;
  objects: readonly CellObject[];
  /** Identifies the filter. */
  view: string;
  isGrouped?: boolean;
}

export function ObjectTable({ label, objects, view, isGrouped = false }: ObjectTableProps) {
  const { t } = useTranslation("cell");
  const [, go] = useLocation();
  const [sorting, setSorting] = useSorting("");
  const all = useColumns();
  // A column that no object has a value for is left out.
  const [hasBattery, hasTime] = [objects.some(({ battery }) => battery !== null), objects.some(({ seenAt }) => seenAt !== null)];
  const columns = useMemo(() => all.filter(({ id }) => (id !== "battery" || hasBattery) && (id !== "seen" || hasTime)), [all, hasBattery, hasTime]);
  const titleOf = useObjectTitle();
  const grouping: Grouping<CellObject> | undefined = isGrouped
    ? { keyOf: ({ kind }) => kind, nameOf: (kind, count) => t("group", { kind: t(`kinds.${kind as ObjectKind}`), count }) }
    : undefined;
  return (
    <DataTable
      label={label}
      rows={objects}
      columns={columns}
      keyOf={keyOf}
      nameOf={titleOf}
      rowHeight={58}
      sorting={sorting}
      onSort={setSorting}
      grouping={grouping}
      view={view}
      onOpen={(object) => go(object.address)}
    >
      {objects.length === 0 && <EmptyState icon={<SearchX aria-hidden size={32} />} title={t("noMatch")} />}
    </DataTable>
  );
}

function keyOf(object: CellObject): string {
  return object.key;
}

/** The title of an object; services have names in the language of the page. */
export function useObjectTitle(): (object: CellObject) => string {
  const { t } = useTranslation("common");
  return (object) => (object.kind === "service" ? t(`services.${object.name}`, { defaultValue: object.title }) : object.title);
}

/** What an object is, in a word: "Robot UR10", "Camera". */
function useKindText(): (object: CellObject) => string {
  const { t } = useTranslation(["cell", "devices", "system"]);
  return (object) => {
    switch (object.kind) {
      case "robot":
        return object.view === null ? t(`devices:kind.${object.registered?.kind ?? "robotArm"}`) : object.view.model;
      case "glove":
        return t(`side.${object.view.hand}`);
      case "device":
      case "sensor":
        return t(`devices:kind.${object.view.kind}`, { defaultValue: object.view.kind });
      case "other":
        return object.view.category.map((category) => t(`system:device.kind.${category}`, { defaultValue: category })).join(", ");
      case "service":
        return t("service");
    }
  };
}

export function ObjectIcon({ object, size = 20 }: { object: CellObject; size?: number }): ReactNode {
  switch (object.kind) {
    case "robot":
      return object.registered === null ? <Bot aria-hidden size={size} /> : <KindIcon kind={object.registered.kind} size={size} />;
    case "glove":
      return <Hand aria-hidden size={size} />;
    case "service":
      return <Activity aria-hidden size={size} />;
    case "other":
      return <Box aria-hidden size={size} />;
    default:
      return <KindIcon kind={object.view.kind} size={size} />;
  }
}

function useColumns(): readonly Column<CellObject>[] {
  const { t, i18n } = useTranslation(["cell", "devices", "system", "common"]);
  const titleOf = useObjectTitle();
  const kindOf = useKindText();
  return useMemo(
    () => [
      {
        id: "object", name: t("column.object"), width: "minmax(160px, 1.6fr)", sortBy: titleOf,
        cell: (object) => (
          <span className="object-name">
            <ObjectIcon object={object} />
            <span>
              <Link href={object.address} tabIndex={-1} className="object-name__link">
                {titleOf(object)}
              </Link>
              <span className="quiet small">{kindOf(object)}</span>
            </span>
          </span>
        ),
      },
      { id: "state", name: t("column.state"), width: "minmax(140px, 1fr)", sortBy: ({ tone }) => TONES.indexOf(tone), cell: (object) => <ObjectState object={object} /> },
      { id: "now", name: t("column.now"), width: "minmax(120px, 2.4fr)", cell: (object) => <Now object={object} /> },
      {
        id: "battery", name: t("column.battery"), width: "minmax(172px, 0.9fr)", sortBy: ({ battery }) => battery,
        cell: ({ battery }) => battery !== null && <Battery level={battery} />,
      },
      {
        id: "alerts", name: t("column.alerts"), width: "minmax(96px, 0.7fr)", isDescendingFirst: true, sortBy: ({ alerts }) => alerts,
        cell: (object) =>
          object.alerts > 0 && (
            <Link href={alertsAddress(object)} tabIndex={-1} className="object-alerts">
              <StatusBadge tone="attention">{t("alerts", { count: object.alerts })}</StatusBadge>
            </Link>
          ),
      },
      {
        id: "seen", name: t("column.seen"), width: "104px", isDescendingFirst: true, sortBy: ({ seenAt }) => (seenAt === null ? null : Date.parse(seenAt)),
        cell: ({ seenAt }) => seenAt !== null && <RelativeTime at={seenAt} />,
      },
    ],
    // eslint-disable-next-line react-hooks/exhaustive-deps -- the texts change with the language only
    [t, i18n.language],
  );
}

function Now({ object }: { object: CellObject }) {
  const nowOf = useNowText();
  return <span className="object-now">{nowOf(object)}</span>;
}

/** Where the Alerts of an object are listed on its page. */
function alertsAddress(object: CellObject): string {
  if (object.kind === "robot" && object.view !== null) return addresses.robot(object.name, "history");
  return object.kind === "glove" ? addresses.glove(object.name, "history") : object.address;
}

/** The worst first. */
const TONES: readonly CellObject["tone"][] = ["stop", "attention", "accent", "ok", "neutral"];
