/** Starts a process: the fields of its start form, and one for each other parameter, of the type of its default. */
import { useCallback, useEffect, useState } from "react";
import { useTranslation } from "react-i18next";
import { startProcess } from "~/api/actions";
import type { DefinitionView, ProcessStart, ProcessView, TaskForm } from "~/api/generated/task-orchestrator";
import { requestService, ApiError } from "~/api/http";
import { ConfirmDialog } from "~/design/ConfirmDialog";
import { Field } from "~/design/Field";
import { Select } from "~/design/Select";
import { useProcessTexts } from "~/live/hooks";
import { useEvaluatedFields } from "~/tasks/evaluated";
import { faultsOf, faultText } from "~/tasks/faults";
import { entered, inputs, type Draft } from "~/tasks/form";
import { FormFields } from "~/tasks/FormFields";
import { filledIn, initialText, kindOf, parameterIn, type Parameter } from "./parameters";
import "./StartDialog.css";

export interface StartDialogProps {
  definition: DefinitionView;
  /** An older version than the latest. */
  version: number | null;
  onClose: () => void;
  onStarted: (process: ProcessView) => void;
}

export function StartDialog({ definition, version, onClose, onStarted }: StartDialogProps) {
  const { t } = useTranslation("processes");
  const { t: ofForm } = useTranslation("tasks");
  const [typed, setTyped] = useState<Record<string, string>>({});
  const [entries, setEntries] = useState<Draft>({});
  const { form, fields } = useStartForm(definition.name, version, entries);
  const paths = new Set(inputs(fields).map((field) => field.path));
  const parameters = definition.parameters.filter((parameter) => !paths.has(parameter.name));
  const [faults, setFaults] = useState<Record<string, string>>({});
  // The same press twice, or an answer lost on the way, never starts two.
  const [sent] = useState(() => [...crypto.getRandomValues(new Uint8Array(6))].map((byte) => byte.toString(16).padStart(2, "0")).join(""));
  const [key, setKey] = useState("");

  const start = async () => {
    const filled = filledIn(parameters, typed);
    const result = entered(fields, entries);
    const found = {
      ...Object.fromEntries(Object.entries(filled.faults).map(([name, fault]) => [name, t(`start.fault.${fault}`)])),
      ...Object.fromEntries(Object.entries(result.faults).map(([path, fault]) => [path, faultText(ofForm, fault)])),
    };
    setFaults(found);
    if (Object.keys(found).length > 0) throw new Error(t("start.mend"));
    try {
      onStarted(await begun(definition.name, version, { ...filled.values, ...result.values }, { request: sent, ...(key.trim() === "" ? {} : { key: key.trim() }) }));
    } catch (error) {
      const refused = faultsOf(error);
      if (Object.keys(refused).length > 0) setFaults(refused);
      const name = error instanceof ApiError ? parameterIn(error.problem.detail, definition.parameters) : null;
      if (name !== null && error instanceof ApiError) setFaults({ [name]: error.problem.detail });
      throw error;
    }
  };

  return (
    <ConfirmDialog isOpen onClose={onClose} title={t("start.ask", { title: definition.title })} act={t("start.act", { title: definition.title })} onAct={start}>
      {version !== null && <p className="quiet">{t("start.older", { version })}</p>}
      {form?.id != null && form.version === null && <p className="quiet">{ofForm("formMissing", { form: form.id })}</p>}
      <FormFields fields={fields} draft={entries} faults={faults} onChange={(path, entry) => setEntries((before) => ({ ...before, [path]: entry }))} />
      <Field label={t("start.key")} hint={t("start.keyHint")} value={key} onChange={setKey} maxLength={200} />
      {parameters.length === 0 && fields.length === 0 && <p className="quiet">{t("start.noParameters")}</p>}
      {parameters.map((parameter) => (
        <ParameterField
          key={parameter.name}
          parameter={parameter}
          text={typed[parameter.name] ?? initialText(parameter)}
          error={faults[parameter.name]}
          onChange={(text) => setTyped((before) => ({ ...before, [parameter.name]: text }))}
        />
      ))}
    </ConfirmDialog>
  );
}

/** The start form of a definition with its fields for what is typed; no form until it is known. */
function useStartForm(name: string, version: number | null, entries: Draft) {
  const [sent, setSent] = useState<TaskForm | null>(null);
  const form = useProcessTexts().of(name).localized(sent);
  const evaluate = useCallback(
    (values: Record<string, unknown>) =>
      requestService<TaskForm | null>("task-orchestrator", `definitions/${encodeURIComponent(name)}/start-form${version === null ? "" : `?version=${version}`}`, {
        method: "POST",
        json: { values },
      }),
    [name, version],
  );
  useEffect(() => {
    let isCurrent = true;
    evaluate({}).then(
      (found) => {
        if (isCurrent) setSent(found);
      },
      () => undefined, // the start itself shows why the service does not answer
    );
    return () => {
      isCurrent = false;
    };
  }, [evaluate]);
  return { form, fields: useEvaluatedFields(form, name, entries, evaluate) };
}

interface ParameterFieldProps {
  parameter: Parameter;
  text: string;
  error: string | undefined;
  onChange: (text: string) => void;
}

function ParameterField({ parameter, text, error, onChange }: ParameterFieldProps) {
  const { t } = useTranslation("processes");
  const kind = kindOf(parameter);
  const label = parameter.required ? t("start.required", { name: parameter.name }) : parameter.name;
  if (kind === "boolean") {
    return (
      <Select
        label={label}
        value={text}
        options={[
          { value: "true", name: t("start.yes") },
          { value: "false", name: t("start.no") },
        ]}
        onChange={onChange}
      />
    );
  }
  return (
    <Field
      label={label}
      hint={kind === "text" ? undefined : t(`start.hint.${kind}`)}
      value={text}
      onChange={onChange}
      error={error}
      isRequired={parameter.required}
      validationBehavior="aria"
      inputMode={kind === "number" ? "decimal" : "text"}
    />
  );
}

function begun(name: string, version: number | null, values: Record<string, unknown>, more: Partial<ProcessStart>): Promise<ProcessView> {
  return startProcess(name, values, version === null ? more : { ...more, version });
}
