/** The tasklist: which Tasks a person sees, and in which order. */
import type { ProcessView } from "~/api/generated/task-orchestrator";
import type { TasklistView } from "~/live/messages";
import { shortName } from "~/live/urn";

export const VIEWS = ["all", "mine", "groups", "free"] as const;
export type View = (typeof VIEWS)[number];
export const ORDERS = ["due", "priority", "newest", "name"] as const;
export type Order = (typeof ORDERS)[number];

/** Without one, a Task has the priority of most. */
export const DEFAULT_PRIORITY = 50;

export interface Identity {
  name: string;
  groups: readonly string[];
}

export interface ListedTask {
  task: TasklistView;
  /** The name of its process; null while the process is unknown. */
  processName: string | null;
}

export function listedTasks(tasks: readonly TasklistView[], processes: readonly ProcessView[]): ListedTask[] {
  const names = new Map(processes.map((process) => [process.id, process.name]));
  return tasks.map((task) => ({ task, processName: names.get(task.process) ?? null }));
}

/** Whether `person`, a name or URN, is this person. */
export function isPerson(person: string, name: string): boolean {
  return name !== "" && shortName(person).toLowerCase() === name.toLowerCase();
}

/** Whether a person has claimed a Task, or it is assigned to this person and claimed by nobody. */
export function isMine(task: TasklistView, { name }: Identity): boolean {
  if (task.claimedBy !== null) return isPerson(task.claimedBy, name);
  return task.persons.length === 1 && task.persons.some((person) => isPerson(person, name));
}

/** Whether a Task is offered to a group of this person, or to this person among others. */
export function isOfGroups(task: TasklistView, { name, groups }: Identity): boolean {
  const known = new Set(groups.map((group) => group.toLowerCase()));
  const isAmong = task.persons.length > 1 && task.persons.some((person) => isPerson(person, name));
  return isAmong || task.groups.some((group) => known.has(group.toLowerCase()));
}

/** Whether nobody has a Task yet. */
export function isFree(task: TasklistView): boolean {
  return task.claimedBy === null && task.isClaimable;
}

export function isInView(task: TasklistView, view: View, who: Identity): boolean {
  if (view === "mine") return isMine(task, who);
  if (view === "groups") return isOfGroups(task, who) && !hasDeclined(task, who);
  return view === "all" || (isFree(task) && task.persons.length === 0 && !hasDeclined(task, who));
}

function hasDeclined(task: TasklistView, { name }: Identity): boolean {
  return task.declinedBy.some((person) => isPerson(person, name));
}

/** Whether a Task is put off: its follow-up date is later, and the person has not claimed it. */
export function isLater(task: TasklistView, nowMs: number, { name }: Identity): boolean {
  if (task.claimedBy !== null && isPerson(task.claimedBy, name)) return false;
  return task.followUpDate !== null && Date.parse(task.followUpDate) > nowMs;
}

export type Urgency = "overdue" | "soon" | "later";

const SOON_MS = 4 * 3600 * 1000;

export function urgencyOf(dueDate: string, nowMs: number): Urgency {
  const left = Date.parse(dueDate) - nowMs;
  if (left < 0) return "overdue";
  return left < SOON_MS ? "soon" : "later";
}

export function matches({ task, processName }: ListedTask, find: string): boolean {
  const sought = find.trim().toLowerCase();
  const texts = [task.name, task.description, processName, task.process, task.claimedBy, ...task.groups];
  return sought === "" || texts.some((text) => text?.toLowerCase().includes(sought) === true);
}

const byName = (a: ListedTask, b: ListedTask) => a.task.name.localeCompare(b.task.name, undefined, { numeric: true }) || a.task.id.localeCompare(b.task.id);
const byDue = (a: ListedTask, b: ListedTask) => momentOf(a.task.dueDate) - momentOf(b.task.dueDate);
const byAge = (a: ListedTask, b: ListedTask) => (a.task.since ?? "").localeCompare(b.task.since ?? "");
const byPriority = (a: ListedTask, b: ListedTask) => priorityOf(b.task) - priorityOf(a.task);

const COMPARISONS: Record<Order, (a: ListedTask, b: ListedTask) => number> = {
  due: (a, b) => byDue(a, b) || byPriority(a, b) || byAge(a, b) || byName(a, b),
  priority: (a, b) => byPriority(a, b) || byDue(a, b) || byAge(a, b) || byName(a, b),
  newest: (a, b) => byAge(b, a) || byName(a, b),
  name: byName,
};

export function sorted(tasks: readonly ListedTask[], order: Order): ListedTask[] {
  return [...tasks].sort(COMPARISONS[order]);
}

export function priorityOf({ priority }: Pick<TasklistView, "priority">): number {
  return priority ?? DEFAULT_PRIORITY;
}

function momentOf(moment: string | null): number {
  return moment === null ? 8.64e15 : Date.parse(moment);
}

/** The path of a Task in its process: the diagram with the element marked. */
export function markOf(task: { id: string; element: string }): string {
  return `${task.element}-${task.id.slice(task.id.lastIndexOf("-") + 1)}`;
}
