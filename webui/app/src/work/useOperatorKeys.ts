/** The keys of the operator's page. */
import { useEffect, useState } from "react";
import { useTranslation } from "react-i18next";
import { useKeys, type Key } from "~/shell/keys";
import type { ReportedOutcome } from "./ReportPanel";
import type { OperatorActions } from "./useOperatorActions";

/** A key press shortly after a new step was meant for the previous one. */
const CALM_MS = 600;

export function useOperatorKeys(acts: OperatorActions, step: string, open: (outcome: ReportedOutcome) => void): void {
  const { main, complete, report, pause, start } = acts;
  const { t } = useTranslation("work");
  const isCalm = useCalm(step);
  const keys: Key[] = [];
  if (isCalm && main !== null) {
    keys.push({ key: "Enter", does: main.name, act: main.do }, { key: " ", does: main.name, act: main.do });
    if (start !== null) keys.push({ key: "s", does: main.name, act: main.do });
  }
  if (isCalm && complete !== null) keys.push({ key: "c", does: complete.name, act: complete.do });
  if (isCalm && report !== null) {
    keys.push({ key: "n", does: t("outcome.notGood"), act: () => open("notGood") });
    keys.push({ key: "b", does: t("outcome.problem"), act: () => open("problem") });
  }
  if (pause !== null) keys.push({ key: "p", does: t(pause.goesOn ? "by.goOn" : "by.pause"), act: pause.do });
  useKeys(keys);
}

/** Whether the step is visible for long enough that a key is an answer to it. */
function useCalm(step: string): boolean {
  const [calm, setCalm] = useState<string | null>(null);
  useEffect(() => {
    const timer = setTimeout(() => setCalm(step), CALM_MS);
    return () => clearTimeout(timer);
  }, [step]);
  return calm === step;
}
