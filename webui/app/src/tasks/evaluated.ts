/** The fields of a form; those of a dynamic one for what is typed, as the server has evaluated it last. */
import { useEffect, useState } from "react";
import type { FormField, TaskForm } from "~/api/generated/task-orchestrator";
import { useProcessTexts } from "~/live/hooks";
import { entered, type Draft } from "./form";

const EVALUATE_AFTER_MS = 300;

/** `form` is in the language of the page; `evaluate` keeps its identity as long as it asks for the same form. */
export function useEvaluatedFields(
  form: TaskForm | null,
  definition: string,
  entries: Draft,
  evaluate: (values: Record<string, unknown>) => Promise<TaskForm | null>,
): readonly FormField[] {
  const texts = useProcessTexts().of(definition);
  const [evaluated, setEvaluated] = useState<readonly FormField[] | null>(null);
  const isDynamic = form?.isDynamic === true;
  const fields = evaluated === null ? (form?.fields ?? []) : texts.localized(evaluated);
  const typed = isDynamic ? JSON.stringify(entered(fields, entries).values) : "";
  useEffect(() => {
    if (!isDynamic || typed === "{}") return;
    let isCurrent = true;
    const timer = setTimeout(() => {
      evaluate(JSON.parse(typed) as Record<string, unknown>).then(
        (found) => {
          if (isCurrent && found !== null) setEvaluated(found.fields);
        },
        () => undefined, // without a connection the fields stay as they are; the server checks the result
      );
    }, EVALUATE_AFTER_MS);
    return () => {
      isCurrent = false;
      clearTimeout(timer);
    };
  }, [isDynamic, typed, evaluate]);
  return fields;
}
