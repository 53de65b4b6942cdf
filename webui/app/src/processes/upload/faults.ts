/** Faults: what is wrong with a BPMN file, as the orchestrator's problem details tell it. */
import { Refusal } from "~/api/http";
import { wordsIn } from "~/i18n/server";

export interface BpmnFault {
  element: string | null;
  line: number | null;
  message: string;
}

/** The faults that a refusal names; one without a place where it names none. */
export function faultsOf(refusal: Refusal): BpmnFault[] {
  const told = refusal.problem["faults"];
  const faults = Array.isArray(told) ? told.map(faultOf).filter((fault) => fault !== null) : [];
  return faults.length > 0 ? faults : [{ element: null, line: null, message: wordsIn(refusal.problem, "detail") ?? refusal.problem.detail }];
}

function faultOf(told: unknown): BpmnFault | null {
  if (typeof told !== "object" || told === null) return null;
  const { element, line } = told as Record<string, unknown>;
  const message = wordsIn(told, "message");
  if (message === null) return null;
  return {
    element: typeof element === "string" ? element : null,
    line: typeof line === "number" ? line : null,
    message,
  };
}
