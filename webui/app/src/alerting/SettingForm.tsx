/** The form of a rule, a channel or a route: its name, its fields, saved and deleted; one of a file is only shown. */
import { Trash2 } from "lucide-react";
import { useState, type ReactNode, type SyntheticEvent } from "react";
import { useTranslation } from "react-i18next";
import type { FormField } from "~/api/generated/task-orchestrator";
import { errorText } from "~/api/http";
import { Button } from "~/design/Button";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Field } from "~/design/Field";
import { faultText } from "~/tasks/faults";
import type { Draft, Entered } from "~/tasks/form";
import { FormFields } from "~/tasks/FormFields";

const NAME = /^[A-Za-z0-9][A-Za-z0-9_.-]{0,63}$/;

export interface SettingFormProps<T> {
  /** The name of what is edited; null for a new one. */
  name: string | null;
  /** Why it cannot be changed here. */
  isFixed: string | null;
  fields: readonly FormField[];
  draft: Draft;
  onDraft: (draft: Draft) => void;
  read: () => { value: T; faults: Entered["faults"] };
  onSave: (name: string, value: T) => Promise<unknown>;
  onDelete: (name: string) => Promise<unknown>;
  deleteMeans: string;
  /** What can be done besides, with the value as it is entered now; null while it has faults. */
  children?: (valid: () => T | null) => ReactNode;
}

export function SettingForm<T>({ name, isFixed, fields, draft, onDraft, read, onSave, onDelete, deleteMeans, children }: SettingFormProps<T>) {
  const { t } = useTranslation(["alerting", "common"]);
  const { t: ofForm } = useTranslation("tasks");
  const [entry, setEntry] = useState("");
  const [nameFault, setNameFault] = useState<string | undefined>();
  const [faults, setFaults] = useState<Record<string, string>>({});
  const [failure, setFailure] = useState<string | null>(null);
  const [state, setState] = useState<"idle" | "busy" | "saved">("idle");
  const [asksDelete, setAsksDelete] = useState(false);
  const isReadOnly = isFixed !== null;
  const valid = (): T | null => {
    const { value, faults: found } = read();
    const texts = Object.fromEntries(Object.entries(found).map(([path, fault]) => [path, faultText(ofForm, fault)]));
    setFaults(texts);
    const count = Object.keys(texts).length;
    setFailure(count === 0 ? null : t("form.correct", { count }));
    return count === 0 ? value : null;
  };
  const save = async (event: SyntheticEvent) => {
    event.preventDefault();
    if (state === "busy" || isReadOnly) return;
    const isNamed = name !== null || NAME.test(entry);
    setNameFault(isNamed ? undefined : t("form.nameFault"));
    const value = valid();
    if (value === null || !isNamed) return;
    setState("busy");
    try {
      await onSave(name ?? entry, value);
      setState("saved");
    } catch (error) {
      setState("idle");
      setFailure(errorText(error));
    }
  };
  return (
    <>
      <form className="alerting__form" noValidate onSubmit={(event) => void save(event)}>
        {isReadOnly && <p className="quiet">{isFixed}</p>}
        {name === null && <Field label={t("form.name")} hint={t("form.nameHint")} value={entry} onChange={setEntry} error={nameFault} isRequired validationBehavior="aria" autoFocus />}
        <FormFields
          fields={isReadOnly ? readOnly(fields) : fields}
          draft={draft}
          faults={faults}
          onChange={(path, value) => {
            setState("idle");
            onDraft({ ...draft, [path]: value });
          }}
        />
        {failure !== null && <ErrorMessage>{failure}</ErrorMessage>}
        {!isReadOnly && (
          <div className="alerting__acts">
            {name !== null && (
              <Button icon={<Trash2 aria-hidden size={18} />} onPress={() => setAsksDelete(true)}>
                {t("form.delete")}
              </Button>
            )}
            <Button type="submit" kind="main" isDisabled={state === "busy"}>
              {t("form.save")}
            </Button>
            <span className="quiet small" role="status">{state === "saved" ? t("form.saved") : ""}</span>
          </div>
        )}
      </form>
      {children?.(valid)}
      <ConfirmDialog isOpen={asksDelete} onClose={() => setAsksDelete(false)} kind="stop" title={t("form.deleteTitle", { name: name ?? "" })} act={t("form.delete")} onAct={() => onDelete(name ?? "")}>
        <p>{deleteMeans}</p>
      </ConfirmDialog>
    </>
  );
}

function readOnly(fields: readonly FormField[]): FormField[] {
  return fields.map((field) => ({ ...field, isReadOnly: true, fields: readOnly(field.fields) }));
}
