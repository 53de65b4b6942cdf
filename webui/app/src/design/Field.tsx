/** A labelled line of text. */
import { FieldError, Input, Label, Text, TextField, type TextFieldProps } from "react-aria-components";
import "./Field.css";

export interface FieldProps extends Omit<TextFieldProps, "children" | "className"> {
  label: string;
  hint?: string | undefined;
  placeholder?: string;
  error?: string | undefined;
  size?: "normal" | "large";
}

export function Field({ label, hint, placeholder, error, size = "normal", ...rest }: FieldProps) {
  return (
    <TextField {...rest} className={`field field--${size}`} isInvalid={error !== undefined}>
      <Label>{label}</Label>
      <Input {...(placeholder === undefined ? {} : { placeholder })} />
      {hint !== undefined && <Text slot="description">{hint}</Text>}
      <FieldError>{error}</FieldError>
    </TextField>
  );
}
