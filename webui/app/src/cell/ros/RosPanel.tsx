/** ROS: one row per rule of the bridge, with its state, rates, last value and last error. */
import { Waypoints } from "lucide-react";
import { useMemo } from "react";
import { useTranslation } from "react-i18next";
import { BreakableText } from "~/design/BreakableText";
import { RelativeTime } from "~/design/RelativeTime";
import { Button } from "~/design/Button";
import { EmptyState } from "~/design/EmptyState";
import { ErrorMessage } from "~/design/ErrorMessage";
import { StatusBadge, type Tone } from "~/design/StatusBadge";
import { rate } from "~/design/times";
import { DataTable, type Column } from "~/design/table/DataTable";
import { useSorting } from "~/design/table/useSorting";
import { plainValue } from "~/live/readable";
import { oneLine, stateOf, useRules, type RuleView, type Standing } from "./rules";
import "./RosPanel.css";

const tones: Record<Standing, Tone> = { off: "neutral", silent: "attention", works: "ok", waits: "accent" };

export function RosPanel() {
  const { t } = useTranslation("system");
  const { rules, failure, turn } = useRules();
  const [sorting, setSorting] = useSorting("");
  const columns = useColumns(turn);
  return (
    <>
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      {rules?.length === 0 && (
        <EmptyState icon={<Waypoints aria-hidden size={32} />} title={t("ros.none.title")}>
          {t("ros.none.means")}
        </EmptyState>
      )}
      {rules !== null && rules.length > 0 && (
        <DataTable
          label={t("tab.ros")}
          rows={rules}
          columns={columns}
          keyOf={nameOf}
          nameOf={nameOf}
          rowHeight={76}
          isLabelled
          sorting={sorting}
          onSort={setSorting}
        />
      )}
    </>
  );
}

function nameOf(rule: RuleView): string {
  return rule.name;
}

function useColumns(turn: (rule: RuleView, on: boolean) => void): readonly Column<RuleView>[] {
  const { t, i18n } = useTranslation("system");
  return useMemo(
    () => [
      {
        id: "rule", name: t("ros.rule"), width: "minmax(170px, 2fr)", sortBy: nameOf,
        cell: (rule) => (
          <>
            <span className="cell__name">{rule.name}</span>
            <p className="cell__detail">
              <BreakableText of={rule.from ?? "–"} /> → <BreakableText of={rule.to ?? "–"} />
            </p>
          </>
        ),
      },
      {
        id: "state", name: t("ros.state"), width: "minmax(140px, 1.4fr)", sortBy: (rule) => t(`ros.ruleState.${stateOf(rule)}`),
        cell: (rule) => <StatusBadge tone={tones[stateOf(rule)]}>{t(`ros.ruleState.${stateOf(rule)}`)}</StatusBadge>,
      },
      {
        id: "rates", name: t("ros.rates"), width: "minmax(150px, 1.6fr)", isDescendingFirst: true, sortBy: (rule) => rule.receivedPerS,
        cell: (rule) => (
          <>
            <ul className="ros__rates">
              <li>
                <span className="ros__rate">{rate(rule.receivedPerS, i18n.language)}</span>
                <span>{t("ros.received")}</span>
              </li>
              <li>
                <span className="ros__rate">{rate(rule.forwardedPerS, i18n.language)}</span>
                <span>{t("ros.forwarded")}</span>
              </li>
            </ul>
            {rule.dropped > 0 && <p className="cell__detail">{t("ros.dropped", { count: rule.dropped })}</p>}
          </>
        ),
      },
      { id: "value", name: t("ros.value"), width: "minmax(140px, 1.7fr)", cell: (rule) => <code className="ros__value">{oneLine(plainValue(rule.lastValue))}</code> },
      {
        id: "error", name: t("ros.error"), width: "minmax(140px, 1.7fr)", isDescendingFirst: true,
        sortBy: (rule) => (rule.lastErrorAt === null ? null : Date.parse(rule.lastErrorAt)),
        cell: (rule) => <LastError rule={rule} />,
      },
      {
        id: "act", name: t("ros.act"), width: "minmax(124px, 0.8fr)",
        cell: (rule) => (
          <Button permission="configure" label={t(rule.enabled ? "ros.turnOff" : "ros.turnOn", { rule: rule.name })} onPress={() => turn(rule, !rule.enabled)}>
            {t(rule.enabled ? "ros.off" : "ros.on")}
          </Button>
        ),
      },
    ],
    [t, i18n.language, turn],
  );
}

function LastError({ rule }: { rule: RuleView }) {
  const error = rule.lastError ?? rule.lastUnreadable ?? null;
  if (error === null) return null;
  return (
    <>
      <span className="small">{oneLine(error, 240)}</span>{" "}
      {rule.lastErrorAt !== null && (
        <span className="quiet small">
          <RelativeTime at={rule.lastErrorAt} />
        </span>
      )}
    </>
  );
}
