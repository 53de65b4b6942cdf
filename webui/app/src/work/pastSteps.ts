/** The finished steps of a process: what was asked, what was answered, and when. */
import type { ProcessView, TaskView } from "~/api/generated/task-orchestrator";

const SHOWN = 20;

export interface PastStep {
  id: string;
  asked: string;
  gesture: string | null;
  answer: "ok" | "notGood" | "problem" | "failed" | "cancelled";
  by: "gesture" | "screen" | null;
  operator: string | null;
  note: string | null;
  endedAt: string;
}

/** Return the last finished steps, the newest first. */
export function pastSteps({ tasks }: Pick<ProcessView, "tasks">): PastStep[] {
  return tasks
    .flatMap((task) => (task.endedAt === null ? [] : [stepOf(task, task.endedAt)]))
    .sort((a, b) => Date.parse(b.endedAt) - Date.parse(a.endedAt))
    .slice(0, SHOWN);
}

function stepOf(task: TaskView, endedAt: string): PastStep {
  const output = task.outputParameters ?? {};
  const { by } = output;
  return {
    id: task.id,
    asked: task.description ?? task.name,
    gesture: textOf(task.workParameters["gesture"]),
    answer: answerOf(task, output["outcome"]),
    by: by === "gesture" || by === "screen" ? by : null,
    operator: textOf(output["operator"]),
    note: textOf(output["note"]),
    endedAt,
  };
}

function answerOf({ status, cancelled }: TaskView, outcome: unknown): PastStep["answer"] {
  if (cancelled) return "cancelled";
  if (outcome === "notGood" || outcome === "problem") return outcome;
  return status === "failed" ? "failed" : "ok";
}

function textOf(value: unknown): string | null {
  return typeof value === "string" && value !== "" ? value : null;
}
