/** The result of a Task: the outcome, a note, and the fields of its form. */
import { useState, type ReactNode } from "react";
import { useTranslation } from "react-i18next";
import { errorText } from "~/api/http";
import { Button } from "~/design/Button";
import { Checkbox } from "~/design/Checkbox";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Field } from "~/design/Field";
import { Select } from "~/design/Select";
import { TextBox } from "~/design/TextBox";
import type { Outcome, TasklistView } from "~/live/messages";
import { completeTask } from "./actions";
import { entered, entryOf, fieldsOf, type FieldFault, type FormField } from "./form";

export interface ResultFormProps {
  task: TasklistView;
  by: string;
  icon: ReactNode;
  /** Further acts, beside the one that completes the Task. */
  children: ReactNode;
  onEnd: () => void;
}

const OUTCOMES: readonly Outcome[] = ["ok", "notGood", "problem"];

export function ResultForm({ task, by, icon, children, onEnd }: ResultFormProps) {
  const { t } = useTranslation("tasks");
  const [typed, setTyped] = useState<Record<string, string>>({});
  const [faults, setFaults] = useState<Record<string, FieldFault>>({});
  const [outcome, setOutcome] = useState<Outcome>("ok");
  const [note, setNote] = useState("");
  const [busy, setBusy] = useState(false);
  const [failure, setFailure] = useState<string | null>(null);
  const fields = fieldsOf(task.form, task.inputs);
  const complete = () => {
    const result = entered(task.form, fields, typed);
    const isOk = outcome === "ok";
    setFaults(isOk ? result.faults : {});
    setFailure(null);
    if (isOk && Object.keys(result.faults).length > 0) return;
    setBusy(true);
    completeTask(task.id, by, { outcome, note, outputs: result.values })
      .then(onEnd, (error: unknown) => setFailure(errorText(error)))
      .finally(() => setBusy(false));
  };
  return (
    <form
      className="tasklist__form"
      aria-label={t("result")}
      noValidate
      onSubmit={(event) => {
        event.preventDefault();
        if (!busy) complete();
      }}
    >
      {fields.map((field) => (
        <Entry
          key={field.name}
          field={field}
          text={typed[field.name] ?? entryOf(field)}
          error={faults[field.name]}
          onChange={(text) => setTyped((before) => ({ ...before, [field.name]: text }))}
        />
      ))}
      <Select label={t("outcome.label")} value={outcome} options={OUTCOMES.map((value) => ({ value, name: t(`outcome.${value}`) }))} onChange={(value) => setOutcome(OUTCOMES.find((one) => one === value) ?? "ok")} />
      <TextBox label={t("note")} value={note} onChange={setNote} maxLength={1000} />
      {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
      <div className="tasklist__acts">
        <Button type="submit" kind={outcome === "ok" ? "main" : "stop"} icon={icon} isDisabled={busy}>
          {t(`complete.${outcome}`)}
        </Button>
        {children}
      </div>
    </form>
  );
}

interface EntryProps {
  field: FormField;
  text: string;
  error: FieldFault | undefined;
  onChange: (text: string) => void;
}

function Entry({ field, text, error, onChange }: EntryProps) {
  const { t } = useTranslation("tasks");
  const label = field.isRequired ? t("required", { name: field.title }) : field.title;
  const fault = error === undefined ? undefined : t(`fault.${error}`);
  const hint = field.hint ?? undefined;
  if (field.kind === "boolean") {
    return (
      <Checkbox isSelected={text === "true"} onChange={(isSelected) => onChange(String(isSelected))}>
        {label}
      </Checkbox>
    );
  }
  if (field.kind === "choice") {
    const options = field.options.map(({ name }, nth) => ({ value: String(nth), name }));
    return (
      <div>
        <Select label={label} value={text} options={[{ value: "", name: t("notChosen") }, ...options]} onChange={onChange} />
        {fault !== undefined && <ErrorMessage>{fault}</ErrorMessage>}
      </div>
    );
  }
  const common = { label, hint, value: text, onChange, error: fault, isReadOnly: field.isReadOnly, isRequired: field.isRequired, validationBehavior: "aria" as const };
  if (field.kind === "json") return <TextBox {...common} rows={4} isCode />;
  return <Field {...common} inputMode={field.kind === "text" ? "text" : "decimal"} />;
}
