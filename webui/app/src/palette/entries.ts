/** What the palette finds: objects and pages to open, and acts. */
import { Bell, Bot, ClipboardList, Cpu, Hand, LayoutPanelLeft, ListTodo, Server, SlidersHorizontal, UserRound, Workflow, Zap } from "lucide-react";
import type { ComponentType } from "react";
import type { Permission } from "~/session/session";
import { wordNumbers, type Candidate } from "./ranking";

type Icon = ComponentType<{ size?: number; "aria-hidden"?: boolean }>;

interface KindOfEntry {
  icon: Icon;
  /** Among equal matches the higher comes first. */
  weight: number;
  /** Without it the kind is not shown, also not as something used before. */
  permission?: Permission;
}

/** The kinds, named by `palette:kind`. */
export const KINDS = {
  page: { icon: LayoutPanelLeft, weight: 9 },
  setting: { icon: SlidersHorizontal, weight: 8 },
  act: { icon: Zap, weight: 7 },
  definition: { icon: ClipboardList, weight: 6 },
  robot: { icon: Bot, weight: 6 },
  glove: { icon: Hand, weight: 6 },
  process: { icon: Workflow, weight: 5 },
  device: { icon: Cpu, weight: 5 },
  person: { icon: UserRound, weight: 4 },
  user: { icon: UserRound, weight: 4, permission: "managePeople" },
  patient: { icon: UserRound, weight: 4 },
  machine: { icon: Cpu, weight: 4, permission: "readHealthData" },
  service: { icon: Server, weight: 3 },
  task: { icon: ListTodo, weight: 3 },
  alert: { icon: Bell, weight: 2 },
} as const satisfies Record<string, KindOfEntry>;

export type Kind = keyof typeof KINDS;

export function permissionOf(kind: Kind): Permission | undefined {
  return (KINDS[kind] as KindOfEntry).permission;
}

export interface Entry extends Candidate {
  readonly kind: Kind;
  /** Said behind the name: where it belongs, or in which state it is. */
  readonly detail: string;
  /** The address that opens it. */
  readonly address: string;
  /** Texts by which it is found as well. */
  readonly more: readonly string[];
  /** The live value, from which the acts on it are derived. */
  readonly value?: unknown;
}

export type EntryText = Pick<Entry, "id" | "kind" | "name" | "detail" | "address" | "more" | "value">;

/** An entry with its words. */
export function entryOf(text: EntryText): Entry {
  return { ...text, words: wordNumbers(text.name), moreWords: text.more.flatMap(wordNumbers), weight: KINDS[text.kind].weight };
}
