/** A labelled checkbox. */
import type { ReactNode } from "react";
import { CheckboxButton, CheckboxField } from "react-aria-components";
import "./Checkbox.css";

export interface CheckboxProps {
  isSelected: boolean;
  onChange: (isSelected: boolean) => void;
  size?: "normal" | "large";
  children: ReactNode;
}

export function Checkbox({ isSelected, onChange, size = "normal", children }: CheckboxProps) {
  return (
    <CheckboxField isSelected={isSelected} onChange={onChange}>
      <CheckboxButton className={`checkbox checkbox--${size}`}>
        <span aria-hidden className="checkbox__box" />
        <span>{children}</span>
      </CheckboxButton>
    </CheckboxField>
  );
}
