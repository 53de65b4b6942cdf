/** The result of a Task: the fields of its form, the outcome and a note. What is typed stays until it is sent. */
import { CircleCheck } from "lucide-react";
import { useCallback, useRef, useState, type KeyboardEvent, type ReactNode } from "react";
import { useTranslation } from "react-i18next";
import type { TaskDetails } from "~/api/generated/task-orchestrator";
import { errorText } from "~/api/http";
import { Button } from "~/design/Button";
import { ErrorMessage } from "~/design/ErrorMessage";
import { PinDialog } from "~/design/PinDialog";
import { Select } from "~/design/Select";
import { TextBox } from "~/design/TextBox";
import type { Outcome } from "~/live/messages";
import { completeTask, formOf } from "./actions";
import { draftOf, keepDraft, type ResultDraft } from "./drafts";
import { useEvaluatedFields } from "./evaluated";
import { faultsOf, faultText } from "./faults";
import { entered, inputs, type Entry } from "./form";
import { FormFields } from "./FormFields";

const OUTCOMES: readonly Outcome[] = ["ok", "notGood", "problem"];

export interface ResultFormProps {
  task: TaskDetails;
  by: string;
  /** Further acts, beside the one that completes the Task. */
  children: ReactNode;
  onEnd: (outcome: Outcome) => void;
}

export function ResultForm({ task, by, children, onEnd }: ResultFormProps) {
  const { t } = useTranslation("tasks");
  const [draft, setDraft] = useState<ResultDraft>(() => draftOf(task.id, by) ?? { entries: {}, outcome: "ok", note: "" });
  const [faults, setFaults] = useState<Record<string, string>>({});
  const [busy, setBusy] = useState(false);
  const [failure, setFailure] = useState<string | null>(null);
  const [asksPin, setAsksPin] = useState(false);
  const form = useRef<HTMLFormElement>(null);
  const evaluate = useCallback((values: Record<string, unknown>) => formOf(task.id, { values }), [task.id]);
  const fields = useEvaluatedFields(task.form, task.definition, draft.entries, evaluate);
  const change = (changed: Partial<ResultDraft>) => {
    const after = { ...draft, ...changed };
    setDraft(after);
    keepDraft(task.id, by, after);
  };
  const complete = () => {
    const result = entered(fields, draft.entries);
    const isOk = draft.outcome === "ok";
    const found = Object.fromEntries(Object.entries(result.faults).map(([path, fault]) => [path, faultText(t, fault)]));
    setFaults(isOk ? found : {});
    setFailure(null);
    if (isOk && Object.keys(found).length > 0) {
      focusFirstFault(form.current);
      return;
    }
    if (task.requirePin) {
      setAsksPin(true);
      return;
    }
    setBusy(true);
    send()
      .catch((error: unknown) => {
        setFailure(t("notSent", { why: errorText(error) }));
        if (Object.keys(faultsOf(error)).length > 0) focusFirstFault(form.current);
      })
      .finally(() => setBusy(false));
  };
  const send = async (pin?: string) => {
    const outputs = draft.outcome === "ok" ? entered(fields, draft.entries).values : {};
    try {
      await completeTask(task.id, { by, outcome: draft.outcome, note: draft.note, outputs, ...(pin === undefined ? {} : { pin }) });
    } catch (error) {
      setFaults(faultsOf(error));
      throw error;
    }
    keepDraft(task.id, by, null);
    onEnd(draft.outcome);
  };
  const onKeyDown = (event: KeyboardEvent) => {
    if (event.key !== "Enter" || !(event.ctrlKey || event.metaKey) || busy) return;
    event.preventDefault();
    complete();
  };
  const known = new Set(inputs(fields).map((field) => field.path));
  const others = Object.entries(faults).filter(([path]) => !known.has(path.split(/\.\d+(\.|$)/)[0] ?? path));
  return (
    <>
      <form
        ref={form}
        className="tasklist__form"
        aria-label={t("result")}
        noValidate
        onKeyDown={onKeyDown}
        onSubmit={(event) => {
          event.preventDefault();
          if (!busy) complete();
        }}
      >
        {task.form !== null && task.form.id !== null && task.form.version === null && <p className="quiet">{t("formMissing", { form: task.form.id })}</p>}
        <FormFields fields={fields} draft={draft.entries} faults={faults} onChange={(path: string, entry: Entry) => change({ entries: { ...draft.entries, [path]: entry } })} />
        <Select label={t("outcome.label")} value={draft.outcome} options={OUTCOMES.map((value) => ({ value, name: t(`outcome.${value}`) }))} onChange={(value) => change({ outcome: OUTCOMES.find((one) => one === value) ?? "ok" })} />
        <TextBox label={t("note")} value={draft.note} onChange={(note) => change({ note })} maxLength={1000} />
        {others.map(([path, text]) => (
          <ErrorMessage key={path}>{`${path}: ${text}`}</ErrorMessage>
        ))}
        {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
        <div className="tasklist__acts">
          <Button type="submit" kind={draft.outcome === "ok" ? "main" : "stop"} icon={<CircleCheck aria-hidden size={18} />} isDisabled={busy}>
            {t(`complete.${draft.outcome}`)}
          </Button>
          {children}
        </div>
      </form>
      {/* Not in the form: its events would also reach the form. */}
      {asksPin && (
        <PinDialog onClose={() => setAsksPin(false)} onPin={send}>
          <p>{task.name}</p>
        </PinDialog>
      )}
    </>
  );
}

function focusFirstFault(form: HTMLFormElement | null): void {
  // The faults are drawn first.
  requestAnimationFrame(() => {
    const invalid = form?.querySelector<HTMLElement>("[aria-invalid=true]") ?? form?.querySelector("[role=alert]")?.parentElement?.querySelector<HTMLElement>("input, select, textarea");
    invalid?.focus();
  });
}
