/** Alerts: a table with filter, sorting and groups, actions on the selected rows, and the details of one Alert. */
import { CircleCheck, SearchX } from "lucide-react";
import { useMemo, useState } from "react";
import { useTranslation } from "react-i18next";
import { compareUrgency } from "~/alerts/attention";
import { useAlertTitle, useSourceName } from "~/alerts/titles";
import { setSound, useSound } from "~/alerts/sound";
import { RelativeTime } from "~/design/RelativeTime";
import { EmptyState } from "~/design/EmptyState";
import { Field } from "~/design/Field";
import { Select } from "~/design/Select";
import { StatusBadge } from "~/design/StatusBadge";
import { alertStateTone, severityTone } from "~/design/states";
import { Checkbox } from "~/design/Checkbox";
import { DataTable, type Column, type Grouping } from "~/design/table/DataTable";
import { useSorting } from "~/design/table/useSorting";
import { useFamily, useHasSnapshot } from "~/live/hooks";
import type { AlertView } from "~/live/messages";
import { useChoice } from "~/route/choice";
import { UnknownName } from "~/route/UnknownName";
import { useQueryParameter } from "~/route/queryParameter";
import { GROUPINGS, passes, SEVERITIES, STATES, valuesOf, type AlertFilter, type AlertGrouping } from "./alert_list";
import { AlertActions } from "./AlertActions";
import { AlertDetail } from "./AlertDetail";
import { severityIcons } from "./icons";
import "./AlertsPanel.css";

export function AlertsPanel() {
  const { t } = useTranslation(["system", "common"]);
  const alerts = useFamily("alert");
  const titleOf = useAlertTitle();
  const sourceOf = useSourceName();
  const { filter, grouping, bar } = useView(alerts);
  const [sorting, setSorting] = useSorting("-severity");
  const [openId, setOpenId] = useQueryParameter("alert");
  const [selected, setSelected] = useState<ReadonlySet<string>>(new Set());
  const hasSnapshot = useHasSnapshot();

  const byId = useMemo(() => new Map(alerts.map((alert) => [alert.id, alert])), [alerts]);
  const matching = useMemo(
    () => alerts.filter((alert) => passes(alert, filter, `${titleOf(alert)} ${sourceOf(alert.source)}`)).sort(compareUrgency),
    [alerts, filter, titleOf, sourceOf],
  );
  const columns = useColumns(titleOf, sourceOf);
  const groups: Grouping<AlertView> | undefined =
    grouping === ""
      ? undefined
      : {
          keyOf: (alert) => alert[grouping],
          nameOf: (group, count) => {
            const name = grouping === "severity" ? t(`common:severity.${group}`) : grouping === "source" ? sourceOf(group) : group;
            return t("alert.group", { name, count });
          },
        };
  const chosen = matching.filter((alert) => selected.has(alert.id));
  const opened = openId === "" ? (alerts.length === 1 ? (alerts[0] ?? null) : null) : (byId.get(openId) ?? null);
  const isUnknown = openId !== "" && opened === null && hasSnapshot;

  if (alerts.length === 0) {
    return (
      <div className="alerts">
        {isUnknown && <UnknownName thing="alert" name={openId} parameter="alert" />}
        {Object.values(filter).some((asked) => asked !== "") && bar}
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
      <AlertActions chosen={chosen} shown={matching.length} onDone={() => setSelected(new Set())} />
      {isUnknown && <UnknownName thing="alert" name={openId} parameter="alert" />}
      <div className="alerts__frame" data-open={opened !== null || undefined}>
        <DataTable
          label={t("tab.alerts")}
          rows={matching}
          columns={columns}
          keyOf={idOf}
          nameOf={titleOf}
          rowHeight={58}
          sorting={sorting}
          onSort={setSorting}
          grouping={groups}
          view={JSON.stringify([filter, grouping])}
          known={byId}
          selected={selected}
          onSelect={setSelected}
          openKey={opened?.id ?? null}
          onOpen={(alert) => setOpenId(alert.id === openId ? "" : alert.id)}
        >
          {matching.length === 0 && <EmptyState icon={<SearchX aria-hidden size={32} />} title={t("alert.noMatch.title")}>{t("alert.noMatch.means")}</EmptyState>}
        </DataTable>
        {opened !== null && <AlertDetail key={opened.id} alert={opened} title={titleOf(opened)} onClose={() => setOpenId("")} />}
      </div>
      <SoundSwitch />
    </div>
  );
}

function idOf(alert: AlertView): string {
  return alert.id;
}

function useColumns(titleOf: (alert: AlertView) => string, sourceOf: (source: string) => string): readonly Column<AlertView>[] {
  const { t } = useTranslation(["system", "common"]);
  return useMemo(
    () => [
      {
        id: "severity", name: t("alert.column.severity"), width: "minmax(132px, 0.8fr)", isDescendingFirst: true,
        sortBy: (alert) => -SEVERITIES.indexOf(alert.severity),
        cell: (alert) => <Severity alert={alert} />,
      },
      {
        id: "title", name: t("alert.column.title"), width: "minmax(180px, 3fr)", sortBy: titleOf,
        cell: (alert) => <strong className="alerts__title">{titleOf(alert)}</strong>,
      },
      {
        id: "source", name: t("alert.column.source"), width: "minmax(100px, 1.2fr)",
        sortBy: (alert) => sourceOf(alert.source),
        cell: (alert) => sourceOf(alert.source),
      },
      {
        id: "state", name: t("alert.column.state"), width: "minmax(150px, 1fr)",
        sortBy: (alert) => STATES.indexOf(alert.state),
        cell: (alert) => <StatusBadge tone={alertStateTone[alert.state]}>{t(`alert.state.${alert.state}`)}</StatusBadge>,
      },
      {
        id: "raised", name: t("alert.column.raised"), width: "112px", isDescendingFirst: true,
        sortBy: (alert) => Date.parse(alert.dateIssued),
        cell: (alert) => <RelativeTime at={alert.dateIssued} />,
      },
    ],
    [t, titleOf, sourceOf],
  );
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

/** The filter and the grouping, stored in the URL, and the bar that sets them. */
function useView(alerts: readonly AlertView[]) {
  const sourceOf = useSourceName();
  const { t } = useTranslation(["system", "common"]);
  const [state, setState] = useQueryParameter("state");
  const [severity, setSeverity] = useQueryParameter("severity");
  const [category, setCategory] = useQueryParameter("category");
  const [source, setSource] = useQueryParameter("from");
  const [text, setText] = useQueryParameter("find");
  const [grouping, setGroup] = useChoice<AlertGrouping>("group", GROUPINGS, "");
  const filter: AlertFilter = useMemo(() => ({ state, severity, category, source, text }), [state, severity, category, source, text]);
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
        options={[all, ...offered(valuesOf(alerts, "source"), source).map((value) => ({ value, name: sourceOf(value) }))]}
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
  return { filter, grouping, bar };
}

function SoundSwitch() {
  const { t } = useTranslation("common");
  return (
    <Checkbox isSelected={useSound()} onChange={setSound}>
      {t("attention.sound")}
    </Checkbox>
  );
}
