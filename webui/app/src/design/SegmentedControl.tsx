/** A choice between a few visible options. */
import { ToggleButton, ToggleButtonGroup } from "react-aria-components";
import "./SegmentedControl.css";

export interface SegmentedControlProps<T extends string> {
  label: string;
  value: T;
  options: readonly { value: T; name: string }[];
  onChange: (value: T) => void;
}

export function SegmentedControl<T extends string>({ label, value, options, onChange }: SegmentedControlProps<T>) {
  return (
    <ToggleButtonGroup
      className="segmented-control"
      aria-label={label}
      selectionMode="single"
      disallowEmptySelection
      selectedKeys={[value]}
      onSelectionChange={(keys) => {
        for (const key of keys) onChange(key as T);
      }}
    >
      {options.map((option) => (
        <ToggleButton key={option.value} id={option.value} className="segmented-control__option">
          {option.name}
        </ToggleButton>
      ))}
    </ToggleButtonGroup>
  );
}
