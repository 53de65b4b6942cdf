/** Tasks: open work for people without gloves; they claim it, do it, and enter the result. */
import { CircleCheck, Hand, ListTodo, Undo2 } from "lucide-react";
import { useRef, useState } from "react";
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import { errorText } from "~/api/http";
import { Button } from "~/design/Button";
import { EmptyState } from "~/design/EmptyState";
import { ErrorMessage } from "~/design/ErrorMessage";
import { RelativeTime } from "~/design/RelativeTime";
import { SegmentedControl } from "~/design/SegmentedControl";
import { StatusBadge } from "~/design/StatusBadge";
import { useFamily } from "~/live/hooks";
import { shortName } from "~/live/urn";
import { pathOf } from "~/processes/address";
import { Json } from "~/processes/process/Values";
import { useQueryParameter } from "~/route/queryParameter";
import { useKeys } from "~/shell/keys";
import { useUserName, useWithName } from "~/shell/userName";
import { claimTask, returnTask } from "./actions";
import { isMine, listedTasks, type ListedTask } from "./list";
import { ResultForm } from "./ResultForm";
import "./TasksPage.css";

const VIEWS = ["all", "mine", "free"] as const;

export default function TasksPage() {
  const { t } = useTranslation(["tasks", "common"]);
  const name = useUserName();
  const [asked, setView] = useQueryParameter("show", "all");
  const [chosen, choose] = useQueryParameter("task");
  const view = VIEWS.find((one) => one === asked) ?? "all";
  const all = listedTasks(useFamily("tasklist"), useFamily("process"));
  const shown = all.filter(({ task }) => view === "all" || (view === "mine" ? isMine(task, name) : task.claimedBy === null && task.isClaimable));
  const open = all.find(({ task }) => shortName(task.id) === chosen) ?? null;
  const list = useRef<HTMLUListElement>(null);
  const step = (by: number) => {
    const buttons = [...(list.current?.querySelectorAll("button") ?? [])];
    const at = buttons.findIndex((button) => button === document.activeElement);
    buttons[Math.min(buttons.length - 1, Math.max(0, at + by))]?.focus();
  };
  useKeys([
    { key: "j", does: t("keys.next"), act: () => step(1) },
    { key: "k", does: t("keys.previous"), act: () => step(-1) },
    { key: "c", does: t("keys.act"), act: () => document.querySelector<HTMLElement>(".tasklist__acts button")?.click() },
  ]);
  return (
    <div className="tasklist">
      <section className="tasklist__list" aria-label={t("list")}>
        <h1>{t("common:pages.tasks")}</h1>
        <SegmentedControl label={t("show.label")} value={view} options={VIEWS.map((value) => ({ value, name: t(`show.${value}`) }))} onChange={setView} />
        {shown.length === 0 && <p className="quiet">{t(all.length === 0 ? "none" : "noneHere")}</p>}
        <ul ref={list}>
          {shown.map((one) => (
            <li key={one.task.id}>
              <button type="button" aria-current={one === open ? "true" : undefined} onClick={() => choose(shortName(one.task.id))}>
                <span className="tasklist__name">{one.name}</span>
                <State listed={one} />
                <span className="quiet small">
                  {one.process === null ? one.task.kind : (one.process.key ?? one.process.title)}
                  {one.task.person !== null && ` · ${shortName(one.task.person)}`}
                </span>
              </button>
            </li>
          ))}
        </ul>
      </section>
      {open === null ? (
        <EmptyState icon={<ListTodo aria-hidden size={40} />} title={t("choose")}>
          {t("chooseHow")}
        </EmptyState>
      ) : (
        <Opened key={open.task.id} listed={open} onEnd={() => choose("")} />
      )}
    </div>
  );
}

function State({ listed: { task } }: { listed: ListedTask }) {
  const { t } = useTranslation(["tasks", "common"]);
  if (task.claimedBy !== null) return <StatusBadge tone="accent">{t("state.claimed", { who: task.claimedBy })}</StatusBadge>;
  if (task.isClaimable) return <StatusBadge tone="attention">{t("state.free")}</StatusBadge>;
  return <StatusBadge tone="neutral">{t("state.performed")}</StatusBadge>;
}

function Opened({ listed, onEnd }: { listed: ListedTask; onEnd: () => void }) {
  const { t } = useTranslation(["tasks", "common"]);
  const { task, name, process } = listed;
  const user = useUserName();
  const { withName, question } = useWithName();
  const [busy, setBusy] = useState(false);
  const [failure, setFailure] = useState<string | null>(null);
  const perform = (act: (by: string) => Promise<unknown>) => {
    setBusy(true);
    setFailure(null);
    void withName(act)
      .catch((error: unknown) => setFailure(errorText(error)))
      .finally(() => setBusy(false));
  };
  const isOwn = task.claimedBy !== null && task.claimedBy === user;
  const inputs = Object.entries(task.inputs);
  return (
    <article className="tasklist__task" aria-label={name}>
      <header>
        <h2>{name}</h2>
        <State listed={listed} />
      </header>
      {task.description !== null && task.description !== name && <p>{task.description}</p>}
      <p className="quiet">
        {process !== null && <Link href={pathOf({ kind: "process", id: process.id })}>{process.key === null ? process.title : `${process.title} · ${process.key}`}</Link>}
        {task.deadline !== null && task.claimedBy === null && (
          <>
            {" "}
            {t("acceptBy")} <RelativeTime at={task.deadline} isStop />
          </>
        )}
      </p>
      {inputs.length > 0 && (
        <dl className="tasklist__inputs">
          {inputs.map(([key, value]) => (
            <div key={key}>
              <dt className="quiet">{key}</dt>
              <dd>
                <Json value={value} label={key} />
              </dd>
            </div>
          ))}
        </dl>
      )}
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      {task.claimedBy === null && task.isClaimable && (
        <div className="tasklist__acts">
          <Button kind="main" icon={<Hand aria-hidden size={18} />} isDisabled={busy} onPress={() => perform((by) => claimTask(task.id, by))}>
            {t("claim")}
          </Button>
        </div>
      )}
      {isOwn && (
        <>
          <ResultForm task={task} by={user} icon={<CircleCheck aria-hidden size={18} />} onEnd={onEnd}>
            <Button icon={<Undo2 aria-hidden size={18} />} isDisabled={busy} onPress={() => perform((by) => returnTask(task.id, by))}>
              {t("return")}
            </Button>
          </ResultForm>
        </>
      )}
      {question}
    </article>
  );
}
