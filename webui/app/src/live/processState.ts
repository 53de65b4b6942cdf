/** The visible state of a process: its status, or "incident" if a part of it cannot continue. */
import type { ProcessView } from "~/api/generated/task-orchestrator";
import type { Status } from "./messages";

export type ProcessState = Status | "incident";

export function processState({ status, incidents }: Pick<ProcessView, "status"> & Partial<Pick<ProcessView, "incidents">>): ProcessState {
  return status !== "completed" && status !== "failed" && (incidents?.length ?? 0) > 0 ? "incident" : status;
}
