/** Labelled text of several lines; `isCode` is for JSON. */
import { FieldError, Label, Text, TextArea, TextField, type TextFieldProps } from "react-aria-components";
import "./Field.css";

export interface TextBoxProps extends Omit<TextFieldProps, "children" | "className"> {
  label: string;
  hint?: string | undefined;
  error?: string | undefined;
  rows?: number;
  isCode?: boolean;
}

export function TextBox({ label, hint, error, rows = 2, isCode = false, ...rest }: TextBoxProps) {
  return (
    <TextField {...rest} className={isCode ? "field field--code" : "field"} isInvalid={error !== undefined}>
      <Label>{label}</Label>
      <TextArea rows={rows} spellCheck={!isCode} />
      {hint !== undefined && <Text slot="description">{hint}</Text>}
      <FieldError>{error}</FieldError>
    </TextField>
  );
}
