/** The select element of the browser, with a label. A value that is no option (an address that names what does not exist) is shown as such. */
import { useId } from "react";
import { useTranslation } from "react-i18next";
import "./Field.css";

export interface SelectProps<T extends string> {
  label: string;
  value: T;
  options: readonly { value: T; name: string }[];
  onChange: (value: T) => void;
}

export function Select<T extends string>({ label, value, options, onChange }: SelectProps<T>) {
  const { t } = useTranslation("common");
  const id = useId();
  const isUnknown = value !== "" && !options.some((option) => option.value === value);
  return (
    <div className="select">
      <label htmlFor={id}>{label}</label>
      <select id={id} value={value} onChange={(event) => onChange(event.target.value as T)}>
        {isUnknown && <option value={value}>{t("unknown.option", { name: value })}</option>}
        {options.map((option) => (
          <option key={option.value} value={option.value}>
            {option.name}
          </option>
        ))}
      </select>
    </div>
  );
}
