/** A field of a form without anything that is not given. */
import type { FormField } from "~/api/generated/task-orchestrator";

export function field(over: Partial<FormField> & Pick<FormField, "path" | "kind">): FormField {
  return {
    label: over.path, hint: null, isRequired: false, isReadOnly: false, initial: null, options: [], minimum: null, maximum: null,
    minLength: null, maxLength: null, pattern: null, textFormat: null, decimals: null, unit: null, isText: false, fields: [], columns: [], ...over,
  };
}
