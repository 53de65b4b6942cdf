/** Sheet: the Tasks of a process as a file for a spreadsheet (CSV) or a program (JSON). */
import { localizedText } from "~/i18n/server";
import type { ProcessView, TaskView } from "~/api/generated/task-orchestrator";
import { nameOf, performerOf } from "../names";
import { courseOf } from "./course";

const COLUMNS = [
  "process", "task", "element", "name", "visit", "performer", "status", "createdAt", "endedAt", "waitedMs", "workedMs",
  "reason", "outputParameters",
] as const;

/** CSV as RFC 4180 has it, with a byte order mark, which spreadsheets need to detect UTF-8. */
export function csvOf(process: Pick<ProcessView, "id">, tasks: readonly TaskView[], nowMs: number): string {
  const rows = tasks.map((task) => {
    const course = courseOf(task, nowMs);
    return [
      process.id,
      task.id,
      task.element,
      nameOf(task),
      task.visit,
      performerOf(task),
      task.status,
      task.createdAt,
      task.endedAt,
      Math.round(course.waitedMs),
      Math.round(course.workedMs),
      localizedText(task, "reason"),
      task.outputParameters === null ? null : JSON.stringify(task.outputParameters),
    ];
  });
  return `\uFEFF${[COLUMNS, ...rows].map((row) => row.map(cell).join(",")).join("\r\n")}\r\n`;
}

/** The process as it is, with these of its Tasks. */
export function jsonOf(process: ProcessView, tasks: readonly TaskView[]): string {
  return `${JSON.stringify({ ...process, tasks }, null, 2)}\n`;
}

/** "bin-picking-7f3a-tasks.csv": a name that sorts and that every file system takes. */
export function fileName(process: Pick<ProcessView, "id" | "definition">, kind: string): string {
  return `${process.definition}-${process.id}-tasks.${kind}`.replace(/[^\w.-]+/g, "_");
}

function cell(value: string | number | null): string {
  if (value === null) return "";
  if (typeof value === "number") return String(value);
  // A spreadsheet would run a cell that begins so as a formula, and names come from files of others.
  const safe = /^[=+\-@\t\r]/.test(value) ? `'${value}` : value;
  return /[",\r\n]/.test(safe) ? `"${safe.replaceAll('"', '""')}"` : safe;
}
