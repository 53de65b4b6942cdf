/** Alerts: a table to filter, sort and group; many are acknowledged or shelved at once; one is explained beside it. */
import { ArrowUp, CircleCheck, SearchX } from "lucide-react";
import { useMemo, useState } from "react";
import { useTranslation } from "react-i18next";
import { useAlertTitle } from "~/alerts/titles";
import { setSound, useSound } from "~/alerts/sound";
import { RelativeTime } from "~/design/RelativeTime";
import { Button } from "~/design/Button";
import { EmptyState } from "~/design/EmptyState";
import { Field } from "~/design/Field";
import { Select } from "~/design/Select";
import { StatusBadge } from "~/design/StatusBadge";
import { alertStateTone, severityTone } from "~/design/states";
import { Checkbox } from "~/design/Checkbox";
import { useStableOrder, useIsReading } from "~/design/useStableOrder";
import { VirtualTable, type Column, type Sorting } from "~/design/VirtualTable";
import { useFamily } from "~/live/hooks";
import type { AlertView } from "~/live/messages";
import { shortName } from "~/live/urn";
import { useQueryParameter } from "~/route/queryParameter";
import { grouped, GROUPINGS, passes, SEVERITIES, sortAlerts, STATES, valuesOf, type AlertFilter, type Grouping } from "./alert_list";
import { AlertActions } from "./AlertActions";
import { AlertDetail } from "./AlertDetail";
import { severityIcons } from "./icons";
import "./AlertsPanel.css";

export function AlertsPanel() {
  const { t } = useTranslation(["system", "common"]);
  const alerts = useFamily("alert");
  const titleOf = useAlertTitle();
  const { filter, grouping, sorting, setSorting, bar } = useView(alerts);
  const [asked, setOpened] = useQueryParameter("alert");
  const [selected, setSelected] = useState<ReadonlySet<string>>(new Set());
  const { isReading, handlers } = useIsReading();

  const byId = useMemo(() => new Map(alerts.map((alert) => [alert.id, alert])), [alerts]);
  const sorted = useMemo(
    () => sortAlerts(alerts.filter((alert) => passes(alert, filter, titleOf(alert))), sorting, titleOf),
    [alerts, filter, sorting, titleOf],
  );
  const signature = JSON.stringify([filter, sorting, grouping]);
  const { rows, waiting, release } = useStableOrder(sorted, idOf, byId, isReading || selected.size > 0, signature);
  const nameOfGroup = (group: string, count: number) => {
    const name = grouping === "severity" ? t(`common:severity.${group}`) : grouping === "source" ? shortName(group) : group;
    return t("alert.group", { name, count });
  };
  const lines = grouped(rows, grouping, nameOfGroup);
  const chosen = rows.filter((alert) => selected.has(alert.id));
  const opened = byId.get(asked) ?? (alerts.length === 1 ? (alerts[0] ?? null) : null);
  const columns = useColumns(titleOf);

  if (alerts.length === 0) {
    return (
      <div className="alerts">
        <EmptyState icon={<CircleCheck aria-hidden size={32} />} title={t("alert.none.title")}>
          {t("alert.none.means")}
        </EmptyState>
        <SoundSwitch />
      </div>
    );
  }
  return (
    <div className="alerts">
      {bar}
      <AlertActions chosen={chosen} shown={sorted.length} onDone={() => setSelected(new Set())} />
      <div className="alerts__frame" data-open={opened !== null || undefined}>
        <div className="alerts__table" {...handlers}>
          {waiting > 0 && (
            <div className="alerts__new">
              <Button kind="main" icon={<ArrowUp aria-hidden size={16} />} onPress={release}>
                {t("alert.new", { count: waiting })}
              </Button>
            </div>
          )}
          <VirtualTable
            label={t("tab.alerts")}
            lines={lines}
            columns={columns}
            rowHeight={58}
            sorting={sorting}
            onSort={setSorting}
            selected={selected}
            onSelect={setSelected}
            nameOf={titleOf}
            openKey={opened?.id ?? null}
            onOpen={(alert) => setOpened(alert.id === asked ? "" : alert.id)}
          >
            {lines.length === 0 && <EmptyState icon={<SearchX aria-hidden size={32} />} title={t("alert.noMatch.title")}>{t("alert.noMatch.means")}</EmptyState>}
          </VirtualTable>
        </div>
        {opened !== null && <AlertDetail key={opened.id} alert={opened} title={titleOf(opened)} onClose={() => setOpened("")} />}
      </div>
      <SoundSwitch />
    </div>
  );
}

function idOf(alert: AlertView): string {
  return alert.id;
}

function useColumns(titleOf: (alert: AlertView) => string): readonly Column<AlertView>[] {
  const { t } = useTranslation(["system", "common"]);
  return [
    { id: "severity", name: t("alert.column.severity"), width: "minmax(132px, 0.8fr)", isSortable: true, cell: (alert) => <Severity alert={alert} /> },
    { id: "title", name: t("alert.column.title"), width: "minmax(180px, 3fr)", isSortable: true, cell: (alert) => <strong className="alerts__title">{titleOf(alert)}</strong> },
    { id: "source", name: t("alert.column.source"), width: "minmax(100px, 1.2fr)", isSortable: true, cell: (alert) => shortName(alert.source) },
    {
      id: "state", name: t("alert.column.state"), width: "minmax(150px, 1fr)", isSortable: true,
      cell: (alert) => <StatusBadge tone={alertStateTone[alert.state]}>{t(`alert.state.${alert.state}`)}</StatusBadge>,
    },
    { id: "raised", name: t("alert.column.raised"), width: "112px", isSortable: true, cell: (alert) => <RelativeTime at={alert.dateIssued} /> },
  ];
}

function Severity({ alert }: { alert: AlertView }) {
  const { t } = useTranslation("common");
  const Icon = severityIcons[alert.severity];
  const tone = alert.state === "new" || alert.state === "acknowledged" ? severityTone[alert.severity] : "neutral";
  return (
    <StatusBadge tone={tone} icon={<Icon aria-hidden size="1.15em" />}>
      {t(`severity.${alert.severity}`)}
    </StatusBadge>
  );
}

/** Filter, grouping and sorting, which the URL holds, and the bar that sets them. */
function useView(alerts: readonly AlertView[]) {
  const { t } = useTranslation(["system", "common"]);
  const [state, setState] = useQueryParameter("state");
  const [severity, setSeverity] = useQueryParameter("severity");
  const [category, setCategory] = useQueryParameter("category");
  const [source, setSource] = useQueryParameter("from");
  const [text, setText] = useQueryParameter("find");
  const [group, setGroup] = useQueryParameter("group");
  const [sort, setSort] = useQueryParameter("sort", "-severity");
  const filter: AlertFilter = useMemo(() => ({ state, severity, category, source, text }), [state, severity, category, source, text]);
  const sorting: Sorting = useMemo(() => ({ by: sort.replace(/^-/, ""), isDescending: sort.startsWith("-") }), [sort]);
  const grouping: Grouping = GROUPINGS.find((one) => one === group) ?? "";
  const all = { value: "", name: t("alert.filter.all") };
  const offered = (values: readonly string[], value: string) => [...new Set([...values, ...(value === "" ? [] : [value])])];
  const bar = (
    <div className="alerts__filter">
      <Select
        label={t("alert.filter.state")}
        value={state}
        options={[
          { value: "", name: t("alert.filter.active") },
          ...STATES.map((value) => ({ value, name: t(`alert.state.${value}`) })),
          { value: "all", name: t("alert.filter.all") },
        ]}
        onChange={setState}
      />
      <Select
        label={t("alert.filter.severity")}
        value={severity}
        options={[all, ...SEVERITIES.map((value) => ({ value, name: t(`common:severity.${value}`) }))]}
        onChange={setSeverity}
      />
      <Select
        label={t("alert.filter.category")}
        value={category}
        options={[all, ...offered(valuesOf(alerts, "category"), category).map((value) => ({ value, name: value }))]}
        onChange={setCategory}
      />
      <Select
        label={t("alert.filter.source")}
        value={source}
        options={[all, ...offered(valuesOf(alerts, "source"), source).map((value) => ({ value, name: shortName(value) }))]}
        onChange={setSource}
      />
      <Select
        label={t("alert.filter.group")}
        value={grouping}
        options={GROUPINGS.map((value) => ({ value, name: t(`alert.grouping.${value || "none"}`) }))}
        onChange={setGroup}
      />
      <Field label={t("alert.filter.text")} value={text} onChange={setText} type="search" />
    </div>
  );
  return { filter, grouping, sorting, setSorting: ({ by, isDescending }: Sorting) => setSort(`${isDescending ? "-" : ""}${by}`), bar };
}

function SoundSwitch() {
  const { t } = useTranslation("common");
  return (
    <Checkbox isSelected={useSound()} onChange={setSound}>
      {t("attention.sound")}
    </Checkbox>
  );
}
