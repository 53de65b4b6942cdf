/** What is wrong: Alerts, services that are away, processes with incidents, and those that failed today. */
import { CircleCheck } from "lucide-react";
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import { attentionOf } from "~/alerts/attention";
import { useAlertTitle, useSourceName } from "~/alerts/titles";
import { Card } from "~/design/Card";
import { RelativeTime } from "~/design/RelativeTime";
import { StatusBadge } from "~/design/StatusBadge";
import { healthTone, priorityTone } from "~/design/states";
import { localizedText } from "~/i18n/server";
import { useNow } from "~/live/clock";
import { useFamily, useTopic } from "~/live/hooks";
import { addresses } from "~/places/addresses";
import { startOfDay } from "./day";
import { MAX_LISTED, More, ProcessName } from "./Section";
import { failedSince, withIncidents } from "./waiting";

export function WrongSection() {
  const { t } = useTranslation(["home", "common"]);
  const titleOf = useAlertTitle();
  const sourceOf = useSourceName();
  const { count, byPriority, worst } = attentionOf(useFamily("alert"));
  const services = (useTopic("services") ?? []).filter((service) => service.state !== "up");
  const processes = useFamily("process");
  const failed = failedSince(processes, startOfDay(useNow()));
  const stopped = withIncidents(processes);
  const total = count + services.length + failed.length + stopped.length;
  return (
    <Card className="home__section" title={t("wrong.title")} aside={<span className="home__count" data-bad={total > 0 || undefined}>{total}</span>}>
      {total === 0 && (
        <p className="home__fine">
          <CircleCheck aria-hidden size={20} /> {t("wrong.none")}
        </p>
      )}
      <ul className="home__list">
        {worst !== null && (
          <li>
            <Link href={addresses.alerts({ alert: worst.id })}>{titleOf(worst)}</Link>
            <StatusBadge tone={priorityTone[worst.priority]}>{t(`common:severity.${worst.severity}`)}</StatusBadge>
            <span>{sourceOf(worst.source)}</span>
            <span className="quiet small">
              <RelativeTime at={worst.dateIssued} />
            </span>
          </li>
        )}
        {count > 1 && (
          <li>
            <Link href={addresses.alerts()}>{t("wrong.alerts", { count })}</Link>
            <span className="quiet small">
              {(["critical", "high", "medium", "low"] as const).filter((priority) => byPriority[priority] > 0).map((priority) => `${t(`common:priority.${priority}`)} ${byPriority[priority]}`).join(" · ")}
            </span>
          </li>
        )}
        {services.map((service) => (
          <li key={service.name}>
            <Link href={addresses.service(service.name)}>{t(`common:services.${service.name}`, { defaultValue: service.name })}</Link>
            <StatusBadge tone={healthTone[service.state]}>{t(`common:health.${service.state}`)}</StatusBadge>
            <span className="quiet small">
              <RelativeTime at={service.since} />
            </span>
          </li>
        ))}
        {stopped.slice(0, MAX_LISTED).map((process) => (
          <li key={process.id}>
            <ProcessName process={process} />
            <StatusBadge tone="stop">{t("common:processStatus.incident")}</StatusBadge>
            <span className="home__why quiet small">{process.incidents[0] && localizedText(process.incidents[0], "reason")}</span>
          </li>
        ))}
        {failed.slice(0, MAX_LISTED).map((process) => (
          <li key={process.id}>
            <ProcessName process={process} />
            <StatusBadge tone="stop">{t("common:processStatus.failed")}</StatusBadge>
            <span className="home__why quiet small">{localizedText(process, "reason")}</span>
          </li>
        ))}
      </ul>
      <More count={stopped.length - MAX_LISTED} href={addresses.processes({ state: "incident" })} />
      <More count={failed.length - MAX_LISTED} href={addresses.processes({ state: "failed" })} />
    </Card>
  );
}
