/** What an object did of late: its Tasks, its Alerts and its events, as far as the services still have them. */
import { useMemo, type ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import type { ProcessView, TaskView } from "~/api/generated/task-orchestrator";
import { Card } from "~/design/Card";
import { RelativeTime } from "~/design/RelativeTime";
import { duration } from "~/design/times";
import { useEvents } from "~/live/hooks";
import { useSampledFamily } from "~/live/sampled";
import { addresses } from "~/places/addresses";
import { nameOf } from "~/processes/names";
import { TaskState } from "~/processes/process/TaskState";
import { useMessageText } from "../events/eventText";
import { isAbout } from "./cellObjects";
import { ObjectAlerts } from "./ObjectAlerts";
import type { ObjectId } from "./useObjectAlerts";
import "./ObjectHistory.css";

const MAX_LISTED = 30;

export default function ObjectHistory({ entity, name, children }: ObjectId & { children?: ReactNode }) {
  return (
    <div className="history">
      <Tasks entity={entity} name={name} />
      <ObjectAlerts entity={entity} name={name} />
      {children}
      <Events name={name} />
    </div>
  );
}

function Tasks({ entity, name }: ObjectId) {
  const { t, i18n } = useTranslation(["cell", "processes", "common"]);
  const processes = useSampledFamily("process");
  const tasks = useMemo(() => tasksInvolving(processes, { entity, name }), [processes, entity, name]);
  return (
    <Card title={t("history.tasks")}>
      {tasks.length === 0 && <p className="quiet">{t("history.noTasks")}</p>}
      <ul className="object-history">
        {tasks.slice(0, MAX_LISTED).map(({ task, process }) => (
          <li key={task.id}>
            <TaskState task={task} />
            <span className="object-history__name">{nameOf(task)}</span>
            <Link href={addresses.process(process.id)}>{process.name}</Link>
            <span className="quiet small">
              {task.endedAt !== null && <>{duration(Date.parse(task.endedAt) - Date.parse(task.createdAt), i18n.language)} · </>}
              <RelativeTime at={task.endedAt ?? task.createdAt} isStop />
            </span>
          </li>
        ))}
      </ul>
      {tasks.length > MAX_LISTED && <p className="quiet small">{t("history.latest", { count: MAX_LISTED })}</p>}
    </Card>
  );
}

/** The Tasks that involve an object, the newest first. */
export function tasksInvolving(processes: readonly ProcessView[], { entity, name }: ObjectId): { task: TaskView; process: ProcessView }[] {
  return processes
    .flatMap((process) => process.tasks.filter(({ involves }) => involves.some((urn) => isAbout(urn, entity, name))).map((task) => ({ task, process })))
    .sort((a, b) => (a.task.createdAt < b.task.createdAt ? 1 : -1));
}

function Events({ name }: { name: string }) {
  const { t } = useTranslation("cell");
  const events = useEvents();
  const textOf = useMessageText();
  const own = useMemo(() => events.filter(({ source }) => source === name).slice(-MAX_LISTED).reverse(), [events, name]);
  return (
    <Card title={t("history.events")} aside={<Link href={addresses.events({ source: name })}>{t("history.allEvents")}</Link>}>
      {own.length === 0 && <p className="quiet">{t("history.noEvents")}</p>}
      <ul className="object-history">
        {own.map((event) => (
          <li key={event.seq}>
            <span className="object-history__name">{textOf(event)}</span>
            <span className="quiet small">
              <RelativeTime at={event.at} isStop />
            </span>
          </li>
        ))}
      </ul>
    </Card>
  );
}
