/** One place in a group of which one is chosen; how it looks is the page's. */
import type { ReactNode } from "react";
import { RadioButton, RadioField } from "react-aria-components";

export interface RadioOptionProps {
  value: string;
  className: string;
  /** What it is called, where what it shows does not say enough. */
  label?: string;
  children: ReactNode;
}

export function RadioOption({ value, className, label, children }: RadioOptionProps) {
  return (
    <RadioField value={value} {...(label === undefined ? {} : { "aria-label": label })}>
      <RadioButton className={className}>{children}</RadioButton>
    </RadioField>
  );
}
