/** The Alerts of an object, on its page. */
import { CircleCheck } from "lucide-react";
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import { severityIcons } from "~/alerts/list/icons";
import { useAlertTitle } from "~/alerts/titles";
import { Card } from "~/design/Card";
import { RelativeTime } from "~/design/RelativeTime";
import { StatusBadge } from "~/design/StatusBadge";
import { alertStateTone, severityTone } from "~/design/states";
import type { AlertView } from "~/live/messages";
import { addresses } from "~/places/addresses";
import { useObjectAlerts, type ObjectId } from "./useObjectAlerts";
import "./ObjectHistory.css";

/** All Alerts of an object, those of late below the open ones. */
export function ObjectAlerts(object: ObjectId) {
  const { t } = useTranslation("cell");
  const { open, past } = useObjectAlerts(object);
  return (
    <Card title={t("column.alerts")} className="object-alerts-card">
      {open.length === 0 && (
        <p className="quiet">
          <CircleCheck aria-hidden size="1em" /> {t("history.noAlerts")}
        </p>
      )}
      <AlertList alerts={open} />
      {past.length > 0 && (
        <>
          <h3>{t("history.past")}</h3>
          <AlertList alerts={past} />
        </>
      )}
    </Card>
  );
}

/** The open Alerts of an object; nothing where there are none. */
export function OpenAlerts(object: ObjectId) {
  const { t } = useTranslation("cell");
  const { open } = useObjectAlerts(object);
  if (open.length === 0) return null;
  return (
    <section className="open-alerts" aria-label={t("column.alerts")}>
      <AlertList alerts={open} />
    </section>
  );
}

function AlertList({ alerts }: { alerts: readonly AlertView[] }) {
  const { t } = useTranslation(["cell", "system", "common"]);
  const titleOf = useAlertTitle();
  return (
    <ul className="object-history">
      {alerts.map((alert) => {
        const Icon = severityIcons[alert.severity];
        return (
          <li key={`${alert.id} ${alert.dateIssued}`}>
            <StatusBadge tone={severityTone[alert.severity]} icon={<Icon aria-hidden size="1.15em" />}>
              {t(`common:severity.${alert.severity}`)}
            </StatusBadge>
            <Link href={addresses.alerts({ alert: alert.id })}>{titleOf(alert)}</Link>
            {alert.state !== "new" && <StatusBadge tone={alertStateTone[alert.state]}>{t(`system:alert.state.${alert.state}`)}</StatusBadge>}
            <span className="quiet small">
              <RelativeTime at={alert.dateIssued} isStop />
            </span>
          </li>
        );
      })}
    </ul>
  );
}
