/** An option of a radio group; the page styles it. */
import type { ReactNode } from "react";
import { RadioButton, RadioField } from "react-aria-components";

export interface RadioOptionProps {
  value: string;
  className: string;
  /** The accessible name, if the visible content is not enough. */
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
