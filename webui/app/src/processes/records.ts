/** Records: processes and definitions as the orchestrator answers them, beyond what is live. */
import { useEffect, useState } from "react";
import { callService, describe, Refusal } from "~/api/http";
import { useTopic } from "~/live/hooks";
import type { ElementCount, ProcessView } from "~/live/messages";
import type { ProcessRow } from "./list/rows";

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

export interface Asked<T> {
  value: T | null;
  /** Why there is none, for people. */
  failure: string | null;
  missing: boolean;
}

const NOTHING = { value: null, failure: null, missing: false };

/** What the orchestrator answers for `path`; asked again when `path` or `turn` changes, not at all for null. */
export function useAsked<T>(path: string | null, turn: string | number = 0): Asked<T> {
  const [answer, setAnswer] = useState<Asked<T> & { path: string | null }>({ ...NOTHING, path: null });
  useEffect(() => {
    if (path === null) return;
    const ending = new AbortController();
    callService<T>("task-orchestrator", path, { signal: ending.signal }).then(
      (value) => setAnswer({ path, value, failure: null, missing: false }),
      (error: unknown) => {
        if (ending.signal.aborted) return;
        const missing = error instanceof Refusal && error.problem.status === 404;
        // What was told before stays in sight while the orchestrator is away.
        setAnswer((before) => ({
          path,
          value: before.path === path ? before.value : null,
          failure: describe(error),
          missing,
        }));
      },
    );
    return () => ending.abort();
  }, [path, turn]);
  return answer.path === path ? answer : NOTHING;
}

/** A process: live while it is, else as the orchestrator remembers it. */
export function useProcess(id: string): Asked<ProcessView> {
  const live = useTopic(`process/${id}`);
  const asked = useAsked<ProcessView>(live === undefined ? `processes/${encodeURIComponent(id)}` : null, id);
  return live === undefined ? asked : { value: live, failure: null, missing: false };
}

/** The file of a version, as it was deployed. */
export function useBpmn(definition: string, version: number | null): Asked<string> {
  return useAsked<string>(version === null ? null : bpmnPath(definition, version));
}

export function bpmnPath(definition: string, version: number): string {
  return `definitions/${encodeURIComponent(definition)}/bpmn?version=${version}`;
}

/** A page of processes that were started before another. */
export function processesBefore(before: string | null, limit: number): Promise<ProcessRow[]> {
  const mark = before === null ? "" : `&before=${encodeURIComponent(before)}`;
  return callService("task-orchestrator", `processes?limit=${limit}${mark}`);
}
