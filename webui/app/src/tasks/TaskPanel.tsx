/** A Task with everything about it: where it belongs, its inputs, its form, comments and history. */
import { ArrowLeft, Hand, Undo2, Workflow, X } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import { Link } from "wouter";
import type { TaskDetails } from "~/api/generated/task-orchestrator";
import { ApiError, errorText } from "~/api/http";
import { useServiceQuery } from "~/api/useServiceQuery";
import { Button } from "~/design/Button";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Loading } from "~/design/Loading";
import { RelativeTime } from "~/design/RelativeTime";
import { TextBox } from "~/design/TextBox";
import { useTopicSelector } from "~/live/hooks";
import type { TasklistView } from "~/live/messages";
import { shortName } from "~/live/urn";
import { pathOf } from "~/processes/address";
import { Json } from "~/processes/process/Values";
import { UnknownName } from "~/route/UnknownName";
import { useUserGroups } from "~/shell/userGroups";
import { useUserName, useWithName } from "~/shell/userName";
import { claimTask, commentOnTask, declineTask, returnTask } from "./actions";
import { Comments } from "./Comments";
import { DueMark } from "./DueMark";
import { History } from "./History";
import { markOf } from "./list";
import { ResultForm } from "./ResultForm";
import { TaskState } from "./TaskState";

const OFFERED_TO_OTHERS = "urn:handover:offered-to-others";
/** Comments that were sent without a page are not pushed. */
const REFRESH_MS = 60_000;

export interface TaskPanelProps {
  id: string;
  /** What is live of the Task; undefined once it has ended. */
  live: TasklistView | undefined;
  onBack: () => void;
  onNews: (text: string) => void;
}

export function TaskPanel({ id, live, onBack, onNews }: TaskPanelProps) {
  const { t } = useTranslation(["tasks", "common"]);
  const comments = useTopicSelector("comments", (all) => all?.counts[shortName(id)]);
  const revision = JSON.stringify([live?.status, live?.claimedBy, live?.declinedBy, comments]);
  const { value: task, failure, missing, reload } = useServiceQuery<TaskDetails>("task-orchestrator", `tasks/${encodeURIComponent(id)}`, { revision, intervalMs: REFRESH_MS });
  const back = (
    <Button kind="quiet" icon={<ArrowLeft aria-hidden size={18} />} onPress={onBack}>
      {t("back")}
    </Button>
  );
  if (task === null) {
    return (
      <article className="tasklist__task" aria-label={t("loading")}>
        <div className="tasklist__back">{back}</div>
        {missing ? <UnknownName thing="task" name={id} parameter="task" /> : failure !== null ? <ErrorMessage>{failure}</ErrorMessage> : <Loading />}
      </article>
    );
  }
  return (
    <article className="tasklist__task" aria-label={task.name}>
      <div className="tasklist__back">{back}</div>
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      <Head task={task} />
      <Inputs task={task} />
      <Acts key={task.id} task={task} onChange={reload} onEnd={onBack} onNews={onNews} />
      <Comments subject={task.id} comments={task.comments} onComment={(request) => commentOnTask(task.id, request).then(reload)} />
      <History entries={task.history} />
    </article>
  );
}

function Head({ task }: { task: TaskDetails }) {
  const { t } = useTranslation(["tasks", "common"]);
  return (
    <>
      <header>
        <h2 tabIndex={-1}>{task.name}</h2>
        {task.endedAt === null ? <TaskState claimedBy={task.claimedBy} isClaimable={task.isClaimable} /> : <span className="quiet">{t(`common:status.${task.status}`)}</span>}
        {task.dueDate !== null && task.endedAt === null && <DueMark dueDate={task.dueDate} />}
        {task.priority !== null && <span className="quiet">{t("priority.is", { priority: task.priority })}</span>}
      </header>
      {task.description !== null && task.description !== task.name && <p>{task.description}</p>}
      <p className="tasklist__where">
        <Workflow aria-hidden size={18} />
        <Link href={`${pathOf({ kind: "process", id: task.process })}?task=${encodeURIComponent(markOf(task))}`}>{t("inProcess", { process: task.processName })}</Link>
        {task.endedAt === null && task.claimedBy === null && task.status === "pending" && (
          <span className="quiet">
            {t("created")} <RelativeTime at={task.createdAt} isStop />
          </span>
        )}
      </p>
    </>
  );
}

function Inputs({ task }: { task: TaskDetails }) {
  const properties = (task.inputsSchema?.["properties"] ?? {}) as Record<string, { title?: string; unit?: string }>;
  const inputs = Object.entries(task.inputs);
  if (inputs.length === 0) return null;
  return (
    <dl className="tasklist__inputs">
      {inputs.map(([key, value]) => {
        const { title = key, unit } = properties[key] ?? {};
        return (
          <div key={key}>
            <dt className="quiet">{title}</dt>
            <dd>{typeof value === "string" || typeof value === "number" ? `${value}${unit === undefined ? "" : ` ${unit}`}` : <Json value={value} label={title} />}</dd>
          </div>
        );
      })}
    </dl>
  );
}

interface ActsProps {
  task: TaskDetails;
  onChange: () => void;
  onEnd: () => void;
  onNews: (text: string) => void;
}

function Acts({ task, onChange, onEnd, onNews }: ActsProps) {
  const { t } = useTranslation(["tasks", "common"]);
  const user = useUserName();
  const groups = useUserGroups();
  const { withName, question } = useWithName();
  const [busy, setBusy] = useState(false);
  const [failure, setFailure] = useState<string | null>(null);
  const [offeredTo, setOfferedTo] = useState<string | null>(null);
  const [declines, setDeclines] = useState(false);
  const [why, setWhy] = useState("");
  const perform = (act: (by: string) => Promise<unknown>, news: string) => {
    setBusy(true);
    setFailure(null);
    void withName(async (by) => {
      try {
        await act(by);
        onNews(news);
      } catch (error) {
        if (error instanceof ApiError && error.problem["type"] === OFFERED_TO_OTHERS) setOfferedTo(errorText(error));
        else setFailure(errorText(error));
      }
      onChange();
    }).finally(() => setBusy(false));
  };
  const claim = (override: boolean) => (by: string) => claimTask(task.id, { by, groups: [...groups], override });
  if (task.endedAt !== null) return null;
  const isOwn = task.claimedBy !== null && task.claimedBy === user;
  const decline = (
    <Button permission="performTasks" icon={<X aria-hidden size={18} />} isDisabled={busy} onPress={() => setDeclines(true)} data-act="decline">
      {t("decline.act")}
    </Button>
  );
  return (
    <>
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      {task.claimedBy === null && task.isClaimable && (
        <div className="tasklist__acts">
          <Button permission="performTasks" kind="main" icon={<Hand aria-hidden size={18} />} isDisabled={busy} onPress={() => perform(claim(false), t("news.claimed"))}>
            {t("claim")}
          </Button>
          {decline}
        </div>
      )}
      {isOwn && (
        <ResultForm
          task={task}
          by={user}
          onEnd={(outcome) => {
            onNews(t(`news.${outcome === "ok" ? "completed" : outcome}`, { name: task.name }));
            onEnd();
          }}
        >
          <Button permission="performTasks" icon={<Undo2 aria-hidden size={18} />} isDisabled={busy} onPress={() => perform((by) => returnTask(task.id, { by }), t("news.returned"))} data-act="return">
            {t("return")}
          </Button>
          {decline}
        </ResultForm>
      )}
      {declines && (
        <ConfirmDialog
          isOpen
          onClose={() => setDeclines(false)}
          title={t("decline.title", { name: task.name })}
          act={t("decline.act")}
          kind="stop"
          isDisabled={why.trim() === ""}
          onAct={async () => {
            await withName(async (by) => {
              await declineTask(task.id, { by, why });
              setWhy("");
              onNews(t("news.declined"));
            });
            onChange();
          }}
        >
          <p>{t("decline.means")}</p>
          <TextBox label={t("decline.why")} value={why} onChange={setWhy} maxLength={2000} autoFocus />
        </ConfirmDialog>
      )}
      <ConfirmDialog
        isOpen={offeredTo !== null}
        onClose={() => setOfferedTo(null)}
        title={t("override.title")}
        act={t("override.act")}
        onAct={async () => {
          await withName(claim(true));
          onNews(t("news.claimed"));
          onChange();
        }}
      >
        <p>{offeredTo}</p>
      </ConfirmDialog>
      {question}
    </>
  );
}
