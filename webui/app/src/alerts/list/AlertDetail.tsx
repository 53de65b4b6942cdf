/** The details of an Alert: meaning, remedy, and who acknowledged or shelved it. */
import { UserCheck, X } from "lucide-react";
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import { kindOf } from "~/alerts/attention";
import { useSourceName } from "~/alerts/titles";
import { RelativeTime } from "~/design/RelativeTime";
import { Button } from "~/design/Button";
import { StatusBadge } from "~/design/StatusBadge";
import { alertStateTone, severityTone } from "~/design/states";
import { exactTime } from "~/design/times";
import { localizedText } from "~/i18n/server";
import type { AlertView } from "~/live/messages";
import { pathOf } from "~/processes/address";
import { shortName } from "~/live/urn";
import { AlertButtons, useAlertActions } from "./AlertActions";
import { severityIcons } from "./icons";

export function AlertDetail({ alert, title, onClose }: { alert: AlertView; title: string; onClose: () => void }) {
  const { t, i18n } = useTranslation(["system", "common"]);
  const acts = useAlertActions(() => undefined);
  const sourceOf = useSourceName();
  const Icon = severityIcons[alert.severity];
  const kind = kindOf(alert);
  return (
    <aside className="alert" aria-label={title}>
      <header className="alert__head">
        <h2>{title}</h2>
        <Button kind="quiet" label={t("alert.close")} icon={<X aria-hidden size={18} />} onPress={onClose} />
      </header>
      <p className="alert__states">
        <StatusBadge tone={severityTone[alert.severity]} icon={<Icon aria-hidden size="1.15em" />}>
          {t(`common:severity.${alert.severity}`)}
        </StatusBadge>
        <StatusBadge tone={alertStateTone[alert.state]}>{t(`alert.state.${alert.state}`)}</StatusBadge>
      </p>
      {kind !== "other" && (
        <>
          <p>{t(`alert.kind.${kind}.means`)}</p>
          <p className="alert__said quiet">{localizedText(alert, "description")}</p>
        </>
      )}
      <dl className="alert__facts">
        <Fact name={t("alert.column.source")}>{sourceOf(alert.source)}</Fact>
        <Fact name={t("alert.column.category")}>{[alert.category, alert.subCategory].filter(Boolean).join(" · ")}</Fact>
        <Fact name={t("alert.column.raised")}>
          <RelativeTime at={alert.dateIssued} isStop />
        </Fact>
        {alert.validTo !== null && (
          <Fact name={t("alert.over")}>
            <RelativeTime at={alert.validTo} isStop />
          </Fact>
        )}
        {alert.state === "shelved" && (
          <Fact name={t("alert.shelvedBy", { by: alert.shelvedBy ?? t("glove.somebody") })}>
            {alert.shelvedUntil === null ? t("alert.noEnd") : t("alert.until", { time: exactTime(alert.shelvedUntil, i18n.language) })}
          </Fact>
        )}
      </dl>
      {alert.acknowledged !== null && (
        <p className="alert__known">
          <UserCheck aria-hidden size={18} />
          {t("alert.acknowledged", { by: alert.acknowledged.by || t("glove.somebody") })} <RelativeTime at={alert.acknowledged.at} isStop />
        </p>
      )}
      <div className="alert__actions">
        <AlertButtons alerts={[alert]} acts={acts} />
        {(kind === "processFailed" || kind === "processIncident") && (
          <Link href={pathOf({ kind: "process", id: shortName(alert.source) })}>{t("alert.openProcess")}</Link>
        )}
      </div>
      {acts.messages}
    </aside>
  );
}

function Fact({ name, children }: { name: string; children: React.ReactNode }) {
  return (
    <div>
      <dt className="quiet small">{name}</dt>
      <dd>{children}</dd>
    </div>
  );
}
