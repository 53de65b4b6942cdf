/** Texts for the faults of a form: those that the page finds, and those that the server finds. */
import { ApiError } from "~/api/http";
import { localizedText } from "~/i18n/server";
import type { FieldFault } from "./form";

/** The text of a fault; `t` translates the namespace "tasks". */
export function faultText(t: (key: string, values: { limit: number | undefined }) => string, { code, limit }: FieldFault): string {
  return t(limit === undefined ? `fault.${code}` : `fault.${code}Limit`, { limit });
}

/** The faults by field that the server has found. */
export function faultsOf(error: unknown): Record<string, string> {
  const listed = error instanceof ApiError ? error.problem["faults"] : undefined;
  if (!Array.isArray(listed)) return {};
  return Object.fromEntries((listed as { field: string; reason: string }[]).map((fault) => [fault.field, localizedText(fault, "reason") ?? fault.reason]));
}
