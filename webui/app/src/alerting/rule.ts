/** An anomaly rule as a form: its fields, and the way there and back. */
import type { Rule } from "~/api/generated/device-gateway";
import type { FormField } from "~/api/generated/task-orchestrator";
import { field } from "~/tasks/field";
import { draftOf, entered, type Draft, type Entered } from "~/tasks/form";
import { SEVERITIES } from "./api";

export const CHECKS = ["limits", "rateOfChange", "silence", "zScore", "seasonal"] as const;
export type CheckType = (typeof CHECKS)[number];
export const PERIODS = ["day", "week"] as const;

type Translate = (key: string) => string;

/** The type of check that is chosen in a draft. */
export function checkOf(draft: Draft): CheckType {
  return CHECKS[Number(draft["check.type"])] ?? "limits";
}

/** The fields of a rule with this check; `t` translates the namespace "alerting". Without `definitions` the name is typed. */
export function fieldsOfRule(t: Translate, check: CheckType, definitions: readonly string[]): FormField[] {
  const hint = (name: string) => ({ hint: t(`rule.hint.${name}`) });
  const one = (path: string, kind: FormField["kind"], name: string, over: Partial<FormField> = {}) => field({ path, kind, label: t(`rule.${name}`), ...over });
  const number = (path: string, name: string, over: Partial<FormField> = {}) => one(path, "number", name, over);
  const seconds = (path: string, name: string, over: Partial<FormField> = {}) => number(path, name, { unit: "s", minimum: 0, ...over });
  const choice = (path: string, name: string, values: readonly string[], words: string, over: Partial<FormField> = {}) =>
    one(path, "choice", name, { options: values.map((value) => ({ value, label: t(`${words}.${value}`) })), isRequired: true, ...over });
  const group = (path: string, fields: FormField[]) => field({ path, kind: "group", label: t(`rule.${path}`), fields });
  const deviation = number("check.minimumDeviation", "minimumDeviation", { minimum: 0, ...hint("minimumDeviation") });
  const threshold = number("check.threshold", "threshold", { initial: 4, minimum: 1, maximum: 100, ...hint("threshold") });
  const checks: Record<CheckType, FormField[]> = {
    limits: [number("check.minimum", "minimum"), number("check.maximum", "maximum"), number("check.hysteresis", "hysteresis", { minimum: 0, ...hint("hysteresis") })],
    rateOfChange: [number("check.maxPerS", "maxPerS", { isRequired: true }), seconds("check.overS", "overS", { initial: 10 })],
    silence: [seconds("check.afterS", "afterS", { isRequired: true, initial: 60 })],
    zScore: [threshold, one("check.window", "integer", "window", { initial: 300, minimum: 20, maximum: 100_000, ...hint("window") }), deviation],
    seasonal: [
      threshold,
      choice("check.period", "period", PERIODS, "rule.periods", { initial: "day" }),
      one("check.intervalMin", "integer", "intervalMin", { unit: "min", initial: 30, minimum: 5, maximum: 240 }),
      one("check.historyDays", "integer", "historyDays", { initial: 28, minimum: 2, maximum: 400 }),
      deviation,
    ],
  };
  const definition =
    definitions.length === 0
      ? one("startProcess.definition", "text", "definition")
      : one("startProcess.definition", "choice", "definition", { options: definitions.map((value) => ({ value, label: value })) });
  return [
    group("which", [one("device", "text", "device", { initial: "*", isRequired: true, ...hint("device") }), one("value", "text", "value", { initial: "*", isRequired: true, ...hint("value") })]),
    group("check", [choice("check.type", "type", CHECKS, "rule.types", { initial: "limits" }), ...checks[check]]),
    group("alert", [
      choice("severity", "severity", SEVERITIES, "severity", { initial: "medium" }),
      seconds("forS", "forS", hint("forS")),
      seconds("clearAfterS", "clearAfterS"),
      one("description", "multiline", "description", { maxLength: 500, ...hint("description") }),
      one("enabled", "boolean", "enabled", { initial: true }),
    ]),
    group("startProcess", [definition, one("startProcess.parameters", "json", "parameters", hint("parameters")), seconds("startProcess.cooldownS", "cooldownS", { initial: 600, ...hint("cooldownS") })]),
  ];
}

export function draftOfRule(fields: readonly FormField[], rule: Rule | null): Draft {
  return draftOf(fields, rule);
}

/** A draft with another check: the numbers of the check before it mean something else. */
export function withCheck(t: Translate, draft: Draft): Draft {
  const chosen = Object.fromEntries(Object.entries(draft).filter(([path]) => path === "check.type" || !path.startsWith("check.")));
  return { ...draftOf(fieldsOfRule(t, checkOf(chosen), []).filter(({ path }) => path === "check"), null), ...chosen };
}

/** The rule that was entered; what the form does not show is kept from `before` while the check is the same. */
export function enteredRule(fields: readonly FormField[], draft: Draft, before: Rule | null): { rule: Rule; faults: Entered["faults"] } {
  const { values, faults } = entered(fields, draft);
  const { startProcess, check, ...rest } = values as unknown as Rule;
  if (check.type === "limits" && check.minimum === undefined && check.maximum === undefined) faults["check.minimum"] ??= { code: "required" };
  // Its cooldown has an initial value, so without a definition no process is meant.
  const hasProcess = startProcess?.definition !== undefined;
  if (!hasProcess && startProcess?.parameters !== undefined) faults["startProcess.definition"] ??= { code: "required" };
  const kept = before !== null && before.check.type === check.type ? hidden(before.check, fields) : {};
  return { rule: { ...rest, check: { ...kept, ...check } as Rule["check"], ...(hasProcess ? { startProcess } : {}) }, faults };
}

function hidden(check: Rule["check"], fields: readonly FormField[]): Partial<Rule["check"]> {
  const shown = new Set(fields.flatMap((group) => group.fields.map(({ path }) => path)));
  return Object.fromEntries(Object.entries(check).filter(([name]) => !shown.has(`check.${name}`)));
}

/** Whether a name fits a pattern with `*` and `?`, as the gateway compares them. */
export function fits(pattern: string, name: string): boolean {
  const text = pattern.replace(/[.+^${}()|[\]\\]/g, "\\$&").replaceAll("*", ".*").replaceAll("?", ".");
  return new RegExp(`^${text}$`, "u").test(name);
}
