/** One alert: how grave, what it means, what to do, and who knows of it. */
import { BadgeInfo, CircleAlert, OctagonAlert, TriangleAlert, UserCheck } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import { acknowledge } from "~/api/acts";
import { describe } from "~/api/http";
import { Ago } from "~/design/Ago";
import { Button } from "~/design/Button";
import { Problem } from "~/design/Problem";
import { State } from "~/design/State";
import { severityTone } from "~/design/states";
import type { AlertView, Severity } from "~/live/messages";
import { shortName } from "~/live/urn";
import { pathOf } from "~/processes/address";
import { useWithName } from "~/shell/who";
import { kindOf } from "./alerts";

const icons: Record<Severity, typeof TriangleAlert> = {
  informational: BadgeInfo,
  low: BadgeInfo,
  medium: CircleAlert,
  high: TriangleAlert,
  critical: OctagonAlert,
};

export function AlertCard({ alert }: { alert: AlertView }) {
  const { t } = useTranslation(["system", "common"]);
  const Icon = icons[alert.severity];
  // Those that are over stand below a heading of their own.
  const Title = alert.validTo === null ? "h2" : "h3";
  const kind = kindOf(alert);
  const title = kind === "other" ? (alert.subCategory ?? alert.category) : t(`alert.kind.${kind}.name`);
  return (
    <li className="alert" data-over={alert.validTo !== null || undefined}>
      <div className="alert__head">
        <State tone={alert.validTo === null ? severityTone[alert.severity] : "neutral"} icon={<Icon aria-hidden size="1.15em" />}>
          {t(`common:severity.${alert.severity}`)}
        </State>
        <Title>{title}</Title>
        <span className="quiet">
          {shortName(alert.source)} · <Ago at={alert.dateIssued} />
        </span>
      </div>
      <p>{t(`alert.kind.${kind}.means`)}</p>
      <p className="alert__said quiet small">{alert.description}</p>
      <div className="alert__foot">
        {alert.validTo !== null && (
          <span className="quiet">
            {t("alert.over")} <Ago at={alert.validTo} />
          </span>
        )}
        {alert.acknowledged !== null ? (
          <span className="alert__known">
            <UserCheck aria-hidden size={18} />
            {t("alert.acknowledged", { by: alert.acknowledged.by || t("glove.somebody") })} <Ago at={alert.acknowledged.at} />
          </span>
        ) : (
          alert.validTo === null && <Acknowledge alert={alert.id} />
        )}
        {kind === "processFailed" && (
          <Link href={pathOf({ kind: "process", id: shortName(alert.source) })}>{t("alert.openProcess")}</Link>
        )}
      </div>
    </li>
  );
}

function Acknowledge({ alert }: { alert: string }) {
  const { t } = useTranslation("system");
  const { withName, question } = useWithName();
  const [busy, setBusy] = useState(false);
  const [failure, setFailure] = useState<string | null>(null);
  const press = () => {
    setBusy(true);
    setFailure(null);
    void withName((by) => acknowledge(alert, by))
      .catch((error: unknown) => setFailure(describe(error)))
      .finally(() => setBusy(false));
  };
  return (
    <>
      <Button isDisabled={busy} onPress={press} icon={<UserCheck aria-hidden size={18} />}>
        {t("alert.acknowledge")}
      </Button>
      {failure !== null && <Problem>{failure}</Problem>}
      {question}
    </>
  );
}
