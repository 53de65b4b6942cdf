/** The fields of a form: what is entered, and what is only shown. */
import { ListPlus, Trash2 } from "lucide-react";
import { useTranslation } from "react-i18next";
import type { FormField } from "~/api/generated/task-orchestrator";
import { Button } from "~/design/Button";
import { Checkbox } from "~/design/Checkbox";
import { ErrorMessage } from "~/design/ErrorMessage";
import { Field } from "~/design/Field";
import { Select } from "~/design/Select";
import { TextBox } from "~/design/TextBox";
import { draftOf, entryOf, type Draft, type Entry } from "./form";
import { Note } from "./Note";
import "./FormFields.css";

const MAX_ITEMS = 500;

export interface FormFieldsProps {
  fields: readonly FormField[];
  draft: Draft;
  /** What is wrong, in the language of the page, by path. */
  faults: Readonly<Record<string, string>>;
  /** Stands before the paths of faults: that of an item of a list. */
  prefix?: string;
  onChange: (path: string, entry: Entry) => void;
}

export function FormFields({ fields, draft, faults, prefix = "", onChange }: FormFieldsProps) {
  return fields.map((field) => {
    if (field.kind === "group") {
      return (
        <fieldset key={field.path} className="form-group">
          {field.label !== "" && <legend>{field.label}</legend>}
          <FormFields fields={field.fields} draft={draft} faults={faults} prefix={prefix} onChange={onChange} />
        </fieldset>
      );
    }
    const key = field.path === "" ? prefix.slice(0, -1) : `${prefix}${field.path}`;
    return (
      <Input key={field.path} field={field} entry={draft[field.path] ?? entryOf(field)} fault={faults[key]} faults={faults} path={key} onChange={(entry) => onChange(field.path, entry)} />
    );
  });
}

interface InputProps {
  field: FormField;
  entry: Entry;
  fault: string | undefined;
  faults: Readonly<Record<string, string>>;
  path: string;
  onChange: (entry: Entry) => void;
}

function Input({ field, entry, fault, faults, path, onChange }: InputProps) {
  const { t } = useTranslation("tasks");
  const named = field.unit === null ? field.label : `${field.label} (${field.unit})`;
  const label = field.isRequired ? t("required", { name: named }) : named;
  const text = typeof entry === "string" ? entry : "";
  const common = {
    label, hint: field.hint ?? undefined, value: text, onChange, error: fault,
    isReadOnly: field.isReadOnly, isRequired: field.isRequired, validationBehavior: "aria" as const,
  };
  switch (field.kind) {
    case "note":
      return <Note text={field.label} />;
    case "separator":
      return <hr />;
    case "image":
      return typeof field.initial === "string" && field.initial.startsWith("data:image/") ? <img className="form-image" src={field.initial} alt={field.label} /> : <p className="quiet">{field.label}</p>;
    case "link":
      return typeof field.initial === "string" && /^https?:\/\//.test(field.initial) ? <a href={field.initial} target="_blank" rel="noreferrer">{field.label || field.initial}</a> : null;
    case "table":
      return <Rows field={field} />;
    case "computed":
      return (
        <p className="form-computed">
          <span className="quiet">{field.label}</span> <output>{shown(field.initial) || "–"}</output>
        </p>
      );
    case "boolean":
      return (
        <div>
          <Checkbox isSelected={entry === true} onChange={(isSelected) => !field.isReadOnly && onChange(isSelected)}>
            {label}
          </Checkbox>
          {field.hint !== null && <p className="quiet small">{field.hint}</p>}
          {fault !== undefined && <ErrorMessage>{fault}</ErrorMessage>}
        </div>
      );
    case "choice":
      return (
        <div>
          <Select label={label} value={text} options={[{ value: "", name: t("notChosen") }, ...field.options.map((option, nth) => ({ value: String(nth), name: option.label }))]} onChange={(value) => !field.isReadOnly && onChange(value)} />
          {field.hint !== null && <p className="quiet small">{field.hint}</p>}
          {fault !== undefined && <ErrorMessage>{fault}</ErrorMessage>}
        </div>
      );
    case "choices":
      return <Choices field={field} label={label} chosen={Array.isArray(entry) ? (entry as string[]) : []} fault={fault} onChange={onChange} />;
    case "list":
      return <Items field={field} label={label} items={Array.isArray(entry) ? (entry as Draft[]) : []} fault={fault} faults={faults} path={path} onChange={onChange} />;
    case "json":
      return <TextBox {...common} rows={4} isCode />;
    case "multiline":
      return <TextBox {...common} rows={4} />;
    case "date":
      return <Field {...common} type="date" />;
    case "time":
      return <Field {...common} type="time" />;
    case "datetime":
      return <Field {...common} type="datetime-local" />;
    case "number":
    case "integer":
      return <Field {...common} inputMode={field.kind === "integer" ? "numeric" : "decimal"} />;
    default:
      return <Field {...common} inputMode={field.textFormat === "email" ? "email" : field.textFormat === "phone" ? "tel" : "text"} />;
  }
}

function Choices({ field, label, chosen, fault, onChange }: { field: FormField; label: string; chosen: readonly string[]; fault: string | undefined; onChange: (entry: Entry) => void }) {
  return (
    <fieldset className="form-group">
      <legend>{label}</legend>
      {field.options.map((option, nth) => (
        <Checkbox
          key={nth}
          isSelected={chosen.includes(String(nth))}
          onChange={(isSelected) => !field.isReadOnly && onChange(isSelected ? [...chosen, String(nth)] : chosen.filter((one) => one !== String(nth)))}
        >
          {option.label}
        </Checkbox>
      ))}
      {field.hint !== null && <p className="quiet small">{field.hint}</p>}
      {fault !== undefined && <ErrorMessage>{fault}</ErrorMessage>}
    </fieldset>
  );
}

interface ItemsProps {
  field: FormField;
  label: string;
  items: readonly Draft[];
  fault: string | undefined;
  faults: Readonly<Record<string, string>>;
  path: string;
  onChange: (entry: Entry) => void;
}

function Items({ field, label, items, fault, faults, path, onChange }: ItemsProps) {
  const { t } = useTranslation("tasks");
  return (
    <fieldset className="form-group">
      <legend>{label}</legend>
      {items.map((item, nth) => (
        <div key={nth} className="form-item" role="group" aria-label={t("item", { number: nth + 1 })}>
          <FormFields
            fields={field.fields}
            draft={item}
            faults={faults}
            prefix={`${path}.${nth}.`}
            onChange={(inner, entry) => onChange(items.map((one, at) => (at === nth ? { ...one, [inner]: entry } : one)))}
          />
          {!field.isReadOnly && (
            <Button kind="quiet" icon={<Trash2 aria-hidden size={18} />} label={t("removeItem", { number: nth + 1 })} onPress={() => onChange(items.filter((_, at) => at !== nth))} />
          )}
        </div>
      ))}
      {!field.isReadOnly && items.length < MAX_ITEMS && (
        <Button icon={<ListPlus aria-hidden size={18} />} onPress={() => onChange([...items, draftOf(field.fields, null)])}>
          {t("addItem")}
        </Button>
      )}
      {fault !== undefined && <ErrorMessage>{fault}</ErrorMessage>}
    </fieldset>
  );
}

function Rows({ field }: { field: FormField }) {
  const rows = Array.isArray(field.initial) ? (field.initial as Record<string, unknown>[]) : [];
  return (
    <div className="form-table" tabIndex={0} role="region" aria-label={field.label}>
      <table>
        {field.label !== "" && <caption>{field.label}</caption>}
        <thead>
          <tr>
            {field.columns.map((column) => (
              <th key={column.key} scope="col">{column.label}</th>
            ))}
          </tr>
        </thead>
        <tbody>
          {rows.map((row, nth) => (
            <tr key={nth}>
              {field.columns.map((column) => (
                <td key={column.key}>{shown(row[column.key])}</td>
              ))}
            </tr>
          ))}
        </tbody>
      </table>
    </div>
  );
}

function shown(value: unknown): string {
  if (value === null || value === undefined) return "";
  return typeof value === "string" ? value : JSON.stringify(value);
}
