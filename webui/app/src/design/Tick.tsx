/** Something that is so or not, with a box to tick. */
import type { ReactNode } from "react";
import { CheckboxButton, CheckboxField } from "react-aria-components";
import "./Tick.css";

export interface TickProps {
  isSelected: boolean;
  onChange: (isSelected: boolean) => void;
  size?: "normal" | "large";
  children: ReactNode;
}

export function Tick({ isSelected, onChange, size = "normal", children }: TickProps) {
  return (
    <CheckboxField isSelected={isSelected} onChange={onChange}>
      <CheckboxButton className={`tick tick--${size}`}>
        <span aria-hidden className="tick__box" />
        <span>{children}</span>
      </CheckboxButton>
    </CheckboxField>
  );
}
