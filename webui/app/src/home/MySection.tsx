/** What waits for the person at this screen: what a glove asks, the person's Tasks, and those that anybody may claim. */
import { ChevronRight, Hand, ListTodo } from "lucide-react";
import { useMemo, type ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import { Card } from "~/design/Card";
import { RelativeTime } from "~/design/RelativeTime";
import { useNow } from "~/live/clock";
import { useFamily, useTasklist } from "~/live/hooks";
import type { TasklistView } from "~/live/messages";
import { shortName } from "~/live/urn";
import { addresses } from "~/places/addresses";
import { useOwnStation } from "~/session/ownStation";
import { useSession } from "~/session/session";
import { useUserGroups } from "~/shell/userGroups";
import { useUserName } from "~/shell/userName";
import { DueMark } from "~/tasks/DueMark";
import { useHomeGloves, type HomeGlove } from "./gloves";
import { MAX_LISTED, More } from "./Section";
import { tasksFor } from "./waiting";

export function MySection() {
  const { t } = useTranslation("home");
  const gloves = useAskingGloves();
  const name = useUserName();
  const groups = useUserGroups();
  const tasks = useTasklist();
  const names = new Map(useFamily("process").map((process) => [process.id, process.name]));
  const now = useNow();
  const { own, free } = useMemo(() => tasksFor(tasks, { name, groups }, now), [tasks, name, groups, now]);
  const count = gloves.length + own.length;
  const row = (task: TasklistView) => (
    <Row key={task.id} to={addresses.tasks({ task: shortName(task.id) })} icon={<ListTodo aria-hidden size={22} />} title={task.name}>
      {names.get(task.process) !== undefined && <span>{names.get(task.process)}</span>}
      {task.dueDate !== null ? <DueMark dueDate={task.dueDate} /> : task.since !== null && <RelativeTime at={task.since} />}
    </Row>
  );
  return (
    <Card className="home__section" title={t("mine.title")} aside={<span className="home__count">{count}</span>}>
      {count === 0 && <p className="quiet">{t("mine.none")}</p>}
      <ul className="home__tasks">
        {gloves.map(({ glove, task }) => (
          <Row key={glove} to={addresses.work({ glove })} icon={<Hand aria-hidden size={22} />} title={task?.description ?? ""}>
            {t("mine.atGlove", { glove })}
          </Row>
        ))}
        {own.slice(0, MAX_LISTED).map(row)}
      </ul>
      <More count={own.length - MAX_LISTED} href={addresses.tasks({ show: "mine" })} />
      {free.length > 0 && (
        <>
          <h3 className="home__sub">{t("mine.free")}</h3>
          <ul className="home__tasks">{free.slice(0, MAX_FREE).map(row)}</ul>
          <More count={free.length - MAX_FREE} href={addresses.tasks({ show: "free" })} />
        </>
      )}
    </Card>
  );
}

/** What is for everybody is less urgent than what is for this person. */
const MAX_FREE = 3;

interface RowProps {
  to: string;
  icon: ReactNode;
  title: string;
  children: ReactNode;
}

/** The whole row opens the Task: it is pressed in gloves, too. */
function Row({ to, icon, title, children }: RowProps) {
  return (
    <li>
      <Link href={to} className="home__task">
        {icon}
        <span className="home__task-words">
          <strong>{title}</strong>
          <span className="home__task-more quiet small">{children}</span>
        </span>
        <ChevronRight aria-hidden size={22} />
      </Link>
    </li>
  );
}

/** The gloves with a Task: at a station those of the station, else those that the user wears; without accounts all. */
function useAskingGloves(): readonly HomeGlove[] {
  const gloves = useHomeGloves();
  const { hasAccounts, user } = useSession();
  const { isStation, station } = useOwnStation();
  const ofStation = new Set(station?.gloves.map(shortName));
  const person = user?.person ?? null;
  return gloves.filter(({ glove, person: wearer, task }) => {
    if (task === null) return false;
    if (!hasAccounts || user === null) return true;
    return isStation ? ofStation.has(glove) : person !== null && wearer !== null && shortName(wearer) === shortName(person);
  });
}
