/** Tasks: open work for people without gloves; they claim it, do it, and enter the result. */
import { ListTodo } from "lucide-react";
import { useMemo, useRef, useState } from "react";
import { useTranslation } from "react-i18next";
import { EmptyState } from "~/design/EmptyState";
import { useFamily, useTasklist } from "~/live/hooks";
import { shortName } from "~/live/urn";
import { useQueryParameter } from "~/route/queryParameter";
import { useKeys } from "~/shell/keys";
import { useUserGroups } from "~/shell/userGroups";
import { useUserName } from "~/shell/userName";
import { IdentityDialog } from "./IdentityDialog";
import { listedTasks } from "./list";
import { TaskList } from "./TaskList";
import { TaskPanel } from "./TaskPanel";
import "./TasksPage.css";

export default function TasksPage() {
  const { t } = useTranslation(["tasks", "common"]);
  const name = useUserName();
  const groups = useUserGroups();
  const who = useMemo(() => ({ name, groups }), [name, groups]);
  const [chosen, choose] = useQueryParameter("task");
  const [identifies, setIdentifies] = useState(false);
  const [news, setNews] = useState("");
  const page = useRef<HTMLDivElement>(null);
  const search = useRef<HTMLDivElement>(null);
  const tasks = useTasklist();
  const processes = useFamily("process");
  const all = useMemo(() => listedTasks(tasks, processes), [tasks, processes]);
  const offered = useMemo(() => [...new Set(tasks.flatMap((task) => task.groups))], [tasks]);
  const open = all.find(({ task }) => shortName(task.id) === chosen)?.task;
  const row = () => page.current?.querySelector<HTMLElement>('[role="row"][tabindex="0"]');
  const back = () => {
    choose("");
    requestAnimationFrame(() => row()?.focus());
  };
  useKeys([
    { key: "f", does: t("keys.find"), act: () => search.current?.querySelector("input")?.focus() },
    { key: "j", does: t("keys.list"), act: () => row()?.focus() },
    { key: "i", does: t("keys.enter"), act: () => page.current?.querySelector<HTMLElement>(".tasklist__form input, .tasklist__form select, .tasklist__form textarea")?.focus() },
    { key: "n", does: t("keys.comment"), act: () => page.current?.querySelector<HTMLElement>(".comments textarea")?.focus() },
    ...(chosen === "" ? [] : [{ key: "Escape", does: t("keys.back"), act: back }]),
  ]);
  return (
    <div className="tasklist" ref={page} data-open={chosen === "" ? undefined : true}>
      <TaskList tasks={all} who={who} chosen={chosen} onChoose={(task) => {
          setNews("");
          choose(task);
        }} onIdentify={() => setIdentifies(true)} searchRef={search} />
      {chosen === "" ? (
        <EmptyState icon={<ListTodo aria-hidden size={40} />} title={news === "" ? t("choose") : news}>
          {t("chooseHow")}
        </EmptyState>
      ) : (
        <TaskPanel key={chosen} id={chosen} live={open} onBack={back} onNews={setNews} />
      )}
      <p role="status" className="visually-hidden">
        {news}
      </p>
      {identifies && <IdentityDialog offered={offered} onClose={() => setIdentifies(false)} />}
    </div>
  );
}
