/** One line above *Home* and *Work* while urgent Alerts are new: how many, and the worst. It never grows to a list. */
import { OctagonAlert, TriangleAlert } from "lucide-react";
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import { useFamily } from "~/live/hooks";
import { addresses } from "~/places/addresses";
import { attentionOf, isUrgent } from "./attention";
import { useAlertTitle, useSourceName } from "./titles";
import "./AttentionBanner.css";

export function AttentionBanner({ large }: { large: boolean }) {
  const { t } = useTranslation("common");
  const titleOf = useAlertTitle();
  const sourceOf = useSourceName();
  const { byPriority, worst } = attentionOf(useFamily("alert").filter(isUrgent));
  if (worst === null) return null;
  const Icon = byPriority.critical > 0 ? OctagonAlert : TriangleAlert;
  const counts = (["critical", "high"] as const)
    .filter((priority) => byPriority[priority] > 0)
    .map((priority) => t(`attention.${priority}`, { count: byPriority[priority] }));
  return (
    <div className="attention" data-tone={byPriority.critical > 0 ? "stop" : "attention"} data-large={large || undefined} role="status">
      <Icon aria-hidden size="1.3em" className="attention__icon" />
      <p className="attention__words">
        <strong>{counts.join(", ")}</strong>
        <span className="attention__worst">
          {titleOf(worst)} · {sourceOf(worst.source)}
        </span>
      </p>
      <Link href={addresses.alerts()} className="attention__link">
        {t("attention.show")}
      </Link>
    </div>
  );
}

/** The count of new Alerts beside a page's name, in the colour of the worst. */
export function AttentionCount() {
  const { t } = useTranslation("common");
  const { count, worst } = attentionOf(useFamily("alert"));
  if (worst === null) return null;
  const tone = worst.priority === "critical" ? "stop" : worst.priority === "low" ? "neutral" : "attention";
  return (
    <span className={`attention-count attention-count--${tone}`}>
      <TriangleAlert aria-hidden size={13} />
      <span aria-hidden>{count > 999 ? "999+" : count}</span>
      <span className="visually-hidden">
        {t("attention.count", { count, severity: t(`priority.${worst.priority}`) })}
      </span>
    </span>
  );
}
