/** Requests to the orchestrator for processes and definitions. */
import type { ProcessSummary, ProcessView, ProcessView as LiveProcess } from "~/api/generated/task-orchestrator";
import { requestService } from "~/api/http";
import { useServiceQuery, type ServiceQuery } from "~/api/useServiceQuery";
import { useMemo } from "react";
import { useProcessTexts, useTopic } from "~/live/hooks";
import { localizedBpmn } from "./diagram/elements";
import type { ProcessFilter } from "./list/rows";

export const SERVICE = "task-orchestrator";

/** A process: its live view if there is one, otherwise the response of the orchestrator. */
export function useProcess(id: string): ServiceQuery<LiveProcess> {
  const live = useTopic(`process/${id}`);
  const asked = useServiceQuery<ProcessView>(SERVICE, live === undefined ? `processes/${encodeURIComponent(id)}` : null);
  return live === undefined ? asked : { ...asked, value: live, failure: null, missing: false };
}

/** The file of a version, with its names in the language of the page; without a version nothing is loaded. */
export function useBpmn(definition: string, version: number | "newest" | null): ServiceQuery<string> {
  const sent = useServiceQuery<string>(SERVICE, version === null ? null : bpmnPath(definition, version));
  const texts = useProcessTexts().of(definition);
  const value = useMemo(() => (sent.value === null ? null : localizedBpmn(sent.value, texts)), [sent.value, texts]);
  return { ...sent, value };
}

export function bpmnPath(definition: string, version: number | "newest"): string {
  return `definitions/${encodeURIComponent(definition)}/bpmn${version === "newest" ? "" : `?version=${version}`}`;
}

/** A page of the processes that pass, the newest first: those that were started before `before`, if one is named. */
export function processesBefore(
  before: string | null,
  limit: number,
  filter: ProcessFilter,
  search = "",
): Promise<ProcessSummary[]> {
  const [definition = "", version = ""] = filter.definition.split("@");
  const status = filter.status === "incident" ? "inProgress" : filter.status;
  const asked = { before: before ?? "", status, definition, version, involves: filter.involves, search };
  const query = new URLSearchParams({ limit: String(limit) });
  for (const [name, value] of Object.entries(asked)) if (value !== "") query.set(name, value);
  return requestService(SERVICE, `processes?${query.toString()}`);
}
