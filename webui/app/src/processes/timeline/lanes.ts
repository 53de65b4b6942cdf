/** Lanes: the Tasks of each performer beside each other, those at the same time one below the other. */
import type { TaskView } from "~/api/generated/task-orchestrator";
import { performerOf } from "../names";
import { courseOf, type Course } from "./course";

export interface Bar {
  task: TaskView;
  course: Course;
  /** Which row of its lane it lies in, from 0. */
  row: number;
}

export interface Lane {
  performer: string;
  rows: number;
  bars: Bar[];
}

/** The lanes of Tasks at `nowMs`, in the order in which the performers first had something to do. */
export function lanesOf(tasks: readonly TaskView[], nowMs: number): Lane[] {
  const lanes = new Map<string, Bar[]>();
  const inTime = tasks
    .map((task) => ({ task, course: courseOf(task, nowMs) }))
    .sort((a, b) => a.course.fromMs - b.course.fromMs);
  for (const { task, course } of inTime) {
    const performer = performerOf(task);
    const bars = lanes.get(performer) ?? [];
    bars.push({ task, course, row: freeRow(bars, course) });
    lanes.set(performer, bars);
  }
  return [...lanes].map(([performer, bars]) => ({
    performer,
    bars,
    rows: 1 + Math.max(...bars.map((bar) => bar.row)),
  }));
}

/** The first row that is free when `course` begins. */
function freeRow(bars: readonly Bar[], course: Course): number {
  const until: number[] = [];
  for (const bar of bars) until[bar.row] = Math.max(until[bar.row] ?? -Infinity, bar.course.toMs);
  const free = until.findIndex((toMs) => toMs <= course.fromMs);
  return free === -1 ? until.length : free;
}
