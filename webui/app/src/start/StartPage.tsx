/** The start page: running processes, waiting Tasks, problems and the counts of the day. */
import { CircleCheck } from "lucide-react";
import { useState, type ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import { attentionOf } from "~/alerts/attention";
import { useAlertTitle, useSourceName } from "~/alerts/titles";
import type { PeriodStatistics, ProcessView } from "~/api/generated/task-orchestrator";
import { useServiceQuery } from "~/api/useServiceQuery";
import { RelativeTime } from "~/design/RelativeTime";
import { Button } from "~/design/Button";
import { Card } from "~/design/Card";
import { number } from "~/design/numbers";
import { StatusBadge } from "~/design/StatusBadge";
import { healthTone, priorityTone, processTone, statusTone } from "~/design/states";
import { duration, exactTime } from "~/design/times";
import { localizedText } from "~/i18n/server";
import { useNow } from "~/live/clock";
import { useFamily, useTopic } from "~/live/hooks";
import { processState } from "~/live/processState";
import { addresses } from "~/places/addresses";
import { pathOf } from "~/processes/address";
import { FirstSteps } from "./FirstSteps";
import { byPerformer, failedSince, startOfDay, waitingTasks, withIncidents } from "./overview";
import "./StartPage.css";

/** Each list shows this many entries and a link to the rest. */
const MAX_LISTED = 6;
const POLL_INTERVAL_MS = 15_000;
const DISMISSED = "handover.firstSteps";

export default function StartPage() {
  const { t } = useTranslation("common");
  const [isDismissed, dismiss] = useFirstSteps();
  return (
    <div className="start">
      <h1 className="start__title">{t("start.title")}</h1>
      {!isDismissed && <FirstSteps onDismiss={dismiss} />}
      <div className="start__board">
        <Day />
        <Running />
        <WaitingFor />
        <Wrong />
      </div>
      {isDismissed && (
        <div>
          <Button kind="quiet" onPress={() => dismiss(false)}>
            {t("start.showSteps")}
          </Button>
        </div>
      )}
    </div>
  );
}

/** Whether the first steps are hidden: completed (a glove, a robot, a completed process) or dismissed. */
function useFirstSteps(): [boolean, (dismissed?: boolean) => void] {
  const gloves = useFamily("glove");
  const robots = useFamily("robot");
  const isFollowed =
    useFamily("process").some((process) => process.status === "completed") && gloves.some((glove) => glove.connected) && robots.length > 0;
  const [stored, setStored] = useState(() => localStorage.getItem(DISMISSED));
  const dismiss = (dismissed = true) => {
    const value = dismissed ? "dismissed" : "wanted";
    localStorage.setItem(DISMISSED, value);
    setStored(value);
  };
  return [stored === "dismissed" || (stored === null && isFollowed), dismiss];
}

/** The counts of the processes that ended today. */
function useDay(): PeriodStatistics | null {
  const ended = useFamily("process").filter((process) => process.endedAt !== null).map((process) => process.id).join();
  const path = `statistics?since=${encodeURIComponent(startOfDay(useNow()))}`;
  return useServiceQuery<PeriodStatistics>("task-orchestrator", path, { revision: ended, intervalMs: POLL_INTERVAL_MS }).value;
}

/** From how many completed processes a median says something. */
const MIN_FOR_MEDIAN = 3;

function Day() {
  const { t, i18n } = useTranslation("common");
  const day = useDay();
  const formatted = (value: number | undefined) => (value === undefined ? "–" : number(value, i18n.language));
  return (
    <Card className="start__day" title={t("start.day.title")}>
      <dl className="start__figures">
        <Figure name={t("start.day.running")}>{formatted(day?.running)}</Figure>
        <Figure name={t("start.day.completed")}>{formatted(day?.completed)}</Figure>
        <Figure name={t("start.day.failed")} isBad={(day?.failed ?? 0) > 0}>
          {formatted(day?.failed)}
        </Figure>
        <Figure name={t("start.day.median")}>{day?.medianMs == null || day.completed < MIN_FOR_MEDIAN ? "–" : duration(day.medianMs, i18n.language)}</Figure>
      </dl>
    </Card>
  );
}

function Figure({ name, isBad = false, children }: { name: string; isBad?: boolean; children: ReactNode }) {
  return (
    <div>
      <dt className="quiet small">{name}</dt>
      <dd data-bad={isBad || undefined}>{children}</dd>
    </div>
  );
}

function Running() {
  const { t } = useTranslation("common");
  const running = useFamily("process")
    .filter((process) => process.endedAt === null)
    .sort((a, b) => (a.startedAt > b.startedAt ? -1 : 1));
  return (
    <Listing title={t("start.running.title")} all={running} href={addresses.processes()} none={t("start.running.none")}>
      {(process) => (
        <li key={process.id}>
          <ProcessName process={process} />
          <StatusBadge tone={processTone[processState(process)]}>{t(`processStatus.${processState(process)}`)}</StatusBadge>
          <span className="quiet small">{t("start.running.progress", { done: process.done, all: process.activities })}</span>
        </li>
      )}
    </Listing>
  );
}

function WaitingFor() {
  const { t } = useTranslation("common");
  const waiting = waitingTasks(useFamily("process"));
  const who = byPerformer(waiting);
  return (
    <Listing title={t("start.waiting.title")} all={waiting} href={addresses.processes()} none={t("start.waiting.none")}
      lead={who.length > 0 && (
        <p className="start__who small">
          {who.slice(0, MAX_LISTED).map((each) => (
            <span key={each.who}>
              {each.who || t("start.waiting.nobody")} <strong>{each.count}</strong>
            </span>
          ))}
        </p>
      )}
    >
      {({ process, task, who: performer, since }) => (
        <li key={task.id}>
          <Link href={pathOf({ kind: "process", id: process.id })}>{task.name || task.element}</Link>
          <span>{performer || t("start.waiting.nobody")}</span>
          <StatusBadge tone={statusTone[task.status]}>{t(`status.${task.status}`)}</StatusBadge>
          <span className="quiet small">
            <RelativeTime at={since} />
          </span>
        </li>
      )}
    </Listing>
  );
}

/** Alerts, services that are away, processes with incidents, and those that failed today. */
function Wrong() {
  const { t } = useTranslation("common");
  const titleOf = useAlertTitle();
  const sourceOf = useSourceName();
  const { count, byPriority, worst } = attentionOf(useFamily("alert"));
  const services = (useTopic("services") ?? []).filter((service) => service.state !== "up");
  const failed = failedSince(useFamily("process"), startOfDay(useNow()));
  const stopped = withIncidents(useFamily("process"));
  const isFine = count === 0 && services.length === 0 && failed.length === 0 && stopped.length === 0;
  return (
    <Card className="start__card" title={t("start.wrong.title")}>
      {isFine && (
        <p className="start__fine">
          <CircleCheck aria-hidden size={20} /> {t("start.wrong.none")}
        </p>
      )}
      <ul className="start__list">
        {worst !== null && (
          <li>
            <Link href={addresses.alerts({ alert: worst.id })}>{titleOf(worst)}</Link>
            <StatusBadge tone={priorityTone[worst.priority]}>{t(`severity.${worst.severity}`)}</StatusBadge>
            <span>{sourceOf(worst.source)}</span>
            <span className="quiet small">
              <RelativeTime at={worst.dateIssued} />
            </span>
          </li>
        )}
        {count > 1 && (
          <li>
            <Link href={addresses.alerts()}>{t("start.wrong.alerts", { count })}</Link>
            <span className="quiet small">
              {(["critical", "high", "medium", "low"] as const).filter((priority) => byPriority[priority] > 0).map((priority) => `${t(`priority.${priority}`)} ${byPriority[priority]}`).join(" · ")}
            </span>
          </li>
        )}
        {services.map((service) => (
          <li key={service.name}>
            <Link href={addresses.services()}>{t(`services.${service.name}`, { defaultValue: service.name })}</Link>
            <StatusBadge tone={healthTone[service.state]}>{t(`health.${service.state}`)}</StatusBadge>
            <span className="quiet small">
              <RelativeTime at={service.since} />
            </span>
          </li>
        ))}
        {stopped.slice(0, MAX_LISTED).map((process) => (
          <li key={process.id}>
            <ProcessName process={process} />
            <StatusBadge tone="stop">{t("processStatus.incident")}</StatusBadge>
            <span className="start__why quiet small">{process.incidents[0] && localizedText(process.incidents[0], "reason")}</span>
          </li>
        ))}
        {failed.slice(0, MAX_LISTED).map((process) => (
          <li key={process.id}>
            <ProcessName process={process} />
            <StatusBadge tone="stop">{t("processStatus.failed")}</StatusBadge>
            <span className="start__why quiet small">{localizedText(process, "reason")}</span>
          </li>
        ))}
      </ul>
      {stopped.length > MAX_LISTED && <Link href={addresses.processes({ state: "incident" })}>{t("start.more", { count: stopped.length - MAX_LISTED })}</Link>}
      {failed.length > MAX_LISTED && <Link href={addresses.processes({ state: "failed" })}>{t("start.more", { count: failed.length - MAX_LISTED })}</Link>}
    </Card>
  );
}

/** A process by its name, never by its id alone. */
function ProcessName({ process }: { process: ProcessView }) {
  const { i18n } = useTranslation();
  return (
    <Link href={pathOf({ kind: "process", id: process.id })} title={exactTime(process.startedAt, i18n.language)}>
      {process.name}
    </Link>
  );
}

interface ListingProps<T> {
  title: string;
  all: readonly T[];
  href: string;
  none: string;
  lead?: ReactNode;
  children: (item: T) => ReactNode;
}

function Listing<T>({ title, all, href, none, lead, children }: ListingProps<T>) {
  const { t } = useTranslation("common");
  return (
    <Card className="start__card" title={title} aside={<span className="start__count">{all.length}</span>}>
      {all.length === 0 && <p className="quiet">{none}</p>}
      {lead}
      <ul className="start__list">{all.slice(0, MAX_LISTED).map(children)}</ul>
      {all.length > MAX_LISTED && <Link href={href}>{t("start.more", { count: all.length - MAX_LISTED })}</Link>}
    </Card>
  );
}
