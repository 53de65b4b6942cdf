/** What runs, and the open Tasks of everybody. */
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import { RelativeTime } from "~/design/RelativeTime";
import { StatusBadge } from "~/design/StatusBadge";
import { processTone, statusTone } from "~/design/states";
import { useFamily } from "~/live/hooks";
import { processState } from "~/live/processState";
import { addresses } from "~/places/addresses";
import { MAX_LISTED, ProcessName, Section } from "./Section";
import { byPerformer, runningProcesses, waitingTasks } from "./waiting";

export function RunningSection() {
  const { t } = useTranslation(["home", "common"]);
  const running = runningProcesses(useFamily("process"));
  return (
    <Section title={t("running.title")} all={running} href={addresses.processes()} none={t("running.none")}>
      {(process) => (
        <li key={process.id}>
          <ProcessName process={process} />
          <StatusBadge tone={processTone[processState(process)]}>{t(`common:processStatus.${processState(process)}`)}</StatusBadge>
          <span className="quiet small">{t("running.progress", { done: process.done, all: process.activities })}</span>
        </li>
      )}
    </Section>
  );
}

export function OpenSection() {
  const { t } = useTranslation(["home", "common"]);
  const waiting = waitingTasks(useFamily("process"));
  const groups = byPerformer(waiting);
  const nameOf = (who: string) => who || t("open.nobody");
  return (
    <Section
      title={t("open.title")}
      all={waiting}
      href={addresses.processes()}
      none={t("open.none")}
      lead={
        groups.length > 1 && (
          <p className="home__who small">
            {groups.slice(0, MAX_LISTED).map(({ who, count }) => (
              <span key={who}>
                {nameOf(who)} <strong>{count}</strong>
              </span>
            ))}
          </p>
        )
      }
    >
      {({ process, task, who, since }) => (
        <li key={task.id}>
          <Link href={addresses.process(process.id)}>{task.name || task.element}</Link>
          <span>{nameOf(who)}</span>
          <StatusBadge tone={statusTone[task.status]}>{t(`common:status.${task.status}`)}</StatusBadge>
          <span className="quiet small">
            <RelativeTime at={since} />
          </span>
        </li>
      )}
    </Section>
  );
}
