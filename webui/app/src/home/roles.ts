/** What Home shows to whom, and in which order: by what the user may do, the services that run, and the width. */
import { mayDo } from "~/session/session";

export type Role = "operator" | "engineer" | "therapist" | "owner" | "viewer";
export type SectionName = "mine" | "wrong" | "running" | "open" | "day" | "care" | "exercises" | "people";

/** The role whose order suits a user; without accounts everybody may do everything. */
export function homeRole(): Role {
  if (mayDo("configure") || mayDo("runProcesses")) return "engineer";
  if (mayDo("readHealthData")) return "therapist";
  if (mayDo("performTasks")) return "operator";
  return mayDo("managePeople") ? "owner" : "viewer";
}

export interface Around {
  services: readonly string[];
  hasAccounts: boolean;
}

const runs = (...names: string[]) => ({ services }: Around) => names.some((name) => services.includes(name));

const IS_OFFERED: Readonly<Record<SectionName, (around: Around) => boolean>> = {
  mine: () => mayDo("performTasks"),
  wrong: () => mayDo("read"),
  running: (around) => mayDo("read") && runs("task-orchestrator")(around),
  open: (around) => mayDo("read") && runs("task-orchestrator")(around),
  day: (around) => mayDo("read") && runs("task-orchestrator")(around),
  care: (around) => mayDo("readHealthData") && runs("human-state")(around),
  exercises: (around) => mayDo("readHealthData") && runs("whole-body-control", "assistive-devices")(around),
  people: ({ hasAccounts }) => hasAccounts && mayDo("managePeople"),
};

/** The most important in the wide column, the others beside it. */
const COLUMNS: Readonly<Record<Role, readonly [main: readonly SectionName[], beside: readonly SectionName[]]>> = {
  operator: [["mine", "wrong"], ["running", "day"]],
  engineer: [["wrong", "running", "open"], ["mine", "day", "people", "care", "exercises"]],
  therapist: [["care", "exercises", "mine"], ["wrong", "running", "day", "people"]],
  owner: [["people", "wrong"], ["running", "day"]],
  viewer: [["running", "wrong"], ["day", "open"]],
};

/** The sections of each column; `isNarrow`: all in one, with what waits for the user first. */
export function columnsOf(role: Role, around: Around, isNarrow: boolean): readonly (readonly SectionName[])[] {
  const columns = COLUMNS[role].map((names) => names.filter((name) => IS_OFFERED[name](around)));
  if (!isNarrow) return columns.filter((names) => names.length > 0);
  const all = columns.flat();
  return [[...all.filter((name) => name === "mine"), ...all.filter((name) => name !== "mine")]];
}
