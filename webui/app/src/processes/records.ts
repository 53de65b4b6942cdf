/** Records: processes and definitions as the orchestrator answers them, beyond what is live. */
import { requestService } from "~/api/http";
import { useServiceQuery, type ServiceQuery } from "~/api/useServiceQuery";
import { useTopic } from "~/live/hooks";
import type { ElementCount, ProcessView } from "~/live/messages";
import type { ProcessFilter, ProcessRow } from "./list/rows";

export const SERVICE = "task-orchestrator";

export interface Statistics {
  version: number;
  processes: { running: number; completed: number; failed: number };
  elements: Record<string, ElementCount>;
}

/** A version of a definition with its activities, in the order of the file. */
export interface DefinitionRecord {
  name: string;
  version: number;
  title: string;
  deployedAt: string;
  activities: { id: string; name: string; lane: string | null; description: string | null }[];
}

/** What a deployment would lead to. */
export interface Trial {
  name: string;
  version: number;
  title: string;
  created: boolean;
  /** All processes of the file; the first is the one above. */
  definitions: { name: string; version: number; title: string; created: boolean }[];
  /** Parts of the file without effect, as faults are listed. */
  warnings: unknown;
}

/** A process: live while it is, else as the orchestrator remembers it. */
export function useProcess(id: string): ServiceQuery<ProcessView> {
  const live = useTopic(`process/${id}`);
  const asked = useServiceQuery<ProcessView>(SERVICE, live === undefined ? `processes/${encodeURIComponent(id)}` : null);
  return live === undefined ? asked : { ...asked, value: live, failure: null, missing: false };
}

/** The file of a version, as it was deployed. */
export function useBpmn(definition: string, version: number | null): ServiceQuery<string> {
  return useServiceQuery<string>(SERVICE, version === null ? null : bpmnPath(definition, version));
}

export function bpmnPath(definition: string, version: number): string {
  return `definitions/${encodeURIComponent(definition)}/bpmn?version=${version}`;
}

/** A page of the processes that pass, the newest first: those that were started before `before`, if one is named. */
export function processesBefore(
  before: string | null,
  limit: number,
  filter: ProcessFilter,
  search = "",
): Promise<ProcessRow[]> {
  const [definition = "", version = ""] = filter.definition.split("@");
  const status = filter.status === "incident" ? "inProgress" : filter.status;
  const asked = { before: before ?? "", status, definition, version, involves: filter.involves, search };
  const query = new URLSearchParams({ limit: String(limit) });
  for (const [name, value] of Object.entries(asked)) if (value !== "") query.set(name, value);
  return requestService(SERVICE, `processes?${query.toString()}`);
}
