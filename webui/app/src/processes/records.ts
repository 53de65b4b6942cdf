/** Records: processes and definitions as the orchestrator answers them, beyond what is live. */
import { callService } from "~/api/http";
import { useAsked, type Asked } from "~/api/useAsked";
import { useTopic } from "~/live/hooks";
import type { ElementCount, ProcessView } from "~/live/messages";
import type { ProcessRow } from "./list/rows";

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
}

/** A process: live while it is, else as the orchestrator remembers it. */
export function useProcess(id: string): Asked<ProcessView> {
  const live = useTopic(`process/${id}`);
  const asked = useAsked<ProcessView>(SERVICE, live === undefined ? `processes/${encodeURIComponent(id)}` : null, id);
  return live === undefined ? asked : { value: live, failure: null, missing: false };
}

/** The file of a version, as it was deployed. */
export function useBpmn(definition: string, version: number | null): Asked<string> {
  return useAsked<string>(SERVICE, version === null ? null : bpmnPath(definition, version));
}

export function bpmnPath(definition: string, version: number): string {
  return `definitions/${encodeURIComponent(definition)}/bpmn?version=${version}`;
}

/** A page of processes that were started before another. */
export function processesBefore(before: string | null, limit: number): Promise<ProcessRow[]> {
  const mark = before === null ? "" : `&before=${encodeURIComponent(before)}`;
  return callService(SERVICE, `processes?limit=${limit}${mark}`);
}
