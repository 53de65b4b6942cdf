/** The faults of a BPMN file, from the orchestrator's problem details. */
import { ApiError } from "~/api/http";
import { localizedText } from "~/i18n/server";

export interface BpmnFault {
  element: string | null;
  /** The name of the element in the drawing. */
  name: string | null;
  line: number | null;
  message: string;
}

/** The faults that a refusal names; one without a place where it names none. */
export function faultsOf(refusal: ApiError): BpmnFault[] {
  const faults = listedFaults(refusal.problem["faults"]);
  return faults.length > 0 ? faults : [{ element: null, name: null, line: null, message: localizedText(refusal.problem, "detail") ?? refusal.problem.detail }];
}

/** Faults or warnings as the orchestrator lists them. */
export function listedFaults(received: unknown): BpmnFault[] {
  return Array.isArray(received) ? received.map(faultOf).filter((fault) => fault !== null) : [];
}

function faultOf(received: unknown): BpmnFault | null {
  if (typeof received !== "object" || received === null) return null;
  const { element, name, line } = received as Record<string, unknown>;
  const message = localizedText(received, "message");
  if (message === null) return null;
  return {
    element: typeof element === "string" ? element : null,
    name: typeof name === "string" && name !== "" ? name : null,
    line: typeof line === "number" ? line : null,
    message,
  };
}
