/** Comments on a Task or process. A name is verified if its person was signed in. */
import { MessageSquarePlus } from "lucide-react";
import { useState } from "react";
import { useTranslation } from "react-i18next";
import type { CommentRequest, TaskComment } from "~/api/generated/task-orchestrator";
import { errorText } from "~/api/http";
import { Button } from "~/design/Button";
import { ErrorMessage } from "~/design/ErrorMessage";
import { RelativeTime } from "~/design/RelativeTime";
import { TextBox } from "~/design/TextBox";
import { useWithName } from "~/shell/userName";
import { commentDrafts } from "./drafts";
import "./Comments.css";

const MAX_LENGTH = 2000;

export interface CommentsProps {
  /** The Task or process; what is typed is kept for it. */
  subject: string;
  comments: readonly TaskComment[];
  onComment: (request: CommentRequest) => Promise<unknown>;
}

export function Comments({ subject, comments, onComment }: CommentsProps) {
  const { t } = useTranslation("tasks");
  const { withName, question } = useWithName();
  // A request that is repeated after a lost connection has the same id, so that no comment is there twice.
  const [draft, setDraft] = useState(() => commentDrafts.of(subject) ?? { text: "", id: newId() });
  const [busy, setBusy] = useState(false);
  const [failure, setFailure] = useState<string | null>(null);
  const type = (text: string) => {
    const after = { ...draft, text };
    setDraft(after);
    commentDrafts.keep(subject, text === "" ? null : after);
  };
  const send = () => {
    if (draft.text.trim() === "" || busy) return;
    setBusy(true);
    setFailure(null);
    void withName(async (by) => {
      await onComment({ by, text: draft.text, id: draft.id });
      commentDrafts.keep(subject, null);
      setDraft({ text: "", id: newId() });
    })
      .catch((error: unknown) => setFailure(t("notSent", { why: errorText(error) })))
      .finally(() => setBusy(false));
  };
  return (
    <section className="comments" aria-label={t("comments.title")}>
      <h3>{t("comments.title")}</h3>
      {comments.length === 0 ? (
        <p className="quiet">{t("comments.none")}</p>
      ) : (
        <ul>
          {comments.map((comment) => (
            <li key={comment.id}>
              <p className="quiet small">
                <strong>{comment.by}</strong> <RelativeTime at={comment.at} isStop />
                {!comment.verified && ` · ${t("unverified")}`}
              </p>
              <p className="comments__text">{comment.text}</p>
            </li>
          ))}
        </ul>
      )}
      <form
        onSubmit={(event) => {
          event.preventDefault();
          send();
        }}
      >
        <TextBox label={t("comments.new")} value={draft.text} onChange={type} maxLength={MAX_LENGTH} />
        {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
        <Button permission="performTasks" type="submit" icon={<MessageSquarePlus aria-hidden size={18} />} isDisabled={busy || draft.text.trim() === ""}>
          {t("comments.send")}
        </Button>
      </form>
      {question}
    </section>
  );
}

function newId(): string {
  return [...crypto.getRandomValues(new Uint8Array(16))].map((byte) => byte.toString(16).padStart(2, "0")).join("");
}
