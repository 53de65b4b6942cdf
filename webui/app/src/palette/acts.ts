/**
 * The acts of the palette, in one table. Another part of the page adds its own with `addActs`.
 *
 * An act is offered to those who may do it. It opens an address, changes a preference of this device, or shows the question that the
 * page asks for this act everywhere; what moves a robot, confirms, starts or ends something is never done without that question.
 */
import { Ban, BookOpenCheck, Cpu, FileUp, GitBranch, Gamepad2, Hand, HardHat, Keyboard, LogOut, Pause, Play, Ruler, SlidersHorizontal, UserCheck, Volume2 } from "lucide-react";
import i18next from "i18next";
import { lazy, type ComponentType } from "react";
import { isSoundOn, setSound } from "~/alerts/sound";
import type { DefinitionView, ProcessView } from "~/api/generated/task-orchestrator";
import { languages, setLanguage, type Language } from "~/i18n";
import type { AlertView, TasklistView } from "~/live/messages";
import { shortName } from "~/live/urn";
import { addresses } from "~/places/addresses";
import { pathOf } from "~/processes/address";
import { signOut } from "~/session/signOut";
import { currentSession, type Permission } from "~/session/session";
import { areKeysOn, setKeysOn } from "~/shell/keys";
import { storeTheme } from "~/shell/theme";
import { userName } from "~/shell/userName";
import type { Entry, Kind } from "./entries";

/** What an act finds around it. */
export interface ActContext {
  services: readonly string[];
  showPreferences: () => void;
  showKeys: () => void;
}

export interface QuestionProps {
  /** What the act is done to; undefined for an act on no object. */
  subject: Entry | undefined;
  onClose: () => void;
  /** Call it when the act is done; with an address, the page opens it. */
  onDone: (address?: string) => void;
}

interface AnyAct {
  id: string;
  icon: ComponentType<{ size?: number; "aria-hidden"?: boolean }>;
  permission?: Permission;
  /** Further words by which it is found. */
  more?: () => string;
  question?: ComponentType<QuestionProps>;
}

/** An act on no object. It has one of `address`, `run` and `question`. */
export interface PlainAct extends AnyAct {
  /** A setting is listed as such. */
  isSetting?: true;
  text: () => string;
  isOffered?: (around: ActContext) => boolean;
  address?: string;
  run?: (around: ActContext) => unknown;
}

/** An act on an object of a kind, whose live value is a `Value`. It has one of `address` and `question`. */
export interface ObjectAct<Value = never> extends AnyAct {
  of: Kind;
  /** With an empty name, the words of the act itself. */
  text: (name: string) => string;
  isOffered?: (value: Value, entry: (id: string) => Entry | undefined) => boolean;
  address?: (value: Value) => string;
}

export type Act = PlainAct | ObjectAct;

const questions = () => import("./questions");
const Start = lazy(() => questions().then(({ StartQuestion }) => ({ default: StartQuestion })));
const PauseProcess = lazy(() => questions().then(({ PauseQuestion }) => ({ default: PauseQuestion })));
const ResumeProcess = lazy(() => questions().then(({ ResumeQuestion }) => ({ default: ResumeQuestion })));
const Cancel = lazy(() => questions().then(({ CancelQuestion }) => ({ default: CancelQuestion })));
const Migrate = lazy(() => questions().then(({ MigrateQuestion }) => ({ default: MigrateQuestion })));
const Acknowledge = lazy(() => questions().then(({ AcknowledgeQuestion }) => ({ default: AcknowledgeQuestion })));

const text = (id: string) => () => i18next.t(`palette:acts.${id}`);
const textOf = (id: string) => (name: string) => i18next.t(`palette:acts.${id}`, { name });
const more = (id: string) => () => i18next.t(`palette:more.${id}`);
const runs = (service: string) => ({ services }: ActContext) => services.includes(service);
/** An act with the texts of its id. */
const plain = (id: string, act: Omit<PlainAct, "id" | "text" | "more">): PlainAct => ({ id, text: text(id), more: more(id), ...act });
const on = <Value>(of: Kind, id: string, act: Omit<ObjectAct<Value>, "id" | "of" | "text" | "more">): ObjectAct => ({ id, of, text: textOf(id), more: more(id), ...act });

const isRunning = ({ endedAt }: ProcessView) => endedAt === null;

const THEMES = (["light", "dark", "system"] as const).map((theme): PlainAct => ({
  id: `theme.${theme}`,
  isSetting: true,
  icon: SlidersHorizontal,
  text: () => `${i18next.t("common:theme.label")}: ${i18next.t(`common:theme.${theme}`)}`,
  more: more("theme"),
  run: () => storeTheme(theme),
}));

const LANGUAGES = Object.entries(languages).map(([language, name]): PlainAct => ({
  id: `language.${language}`,
  isSetting: true,
  icon: SlidersHorizontal,
  text: () => `${i18next.t("common:language")}: ${name}`,
  more: () => "language Sprache kieli",
  run: () => setLanguage(language as Language),
}));

const ACTS: Act[] = [
  on<DefinitionView>("definition", "start", { icon: Play, permission: "runProcesses", isOffered: ({ unusable }) => unusable === undefined, question: Start }),
  on<ProcessView>("process", "pause", { icon: Pause, permission: "runProcesses", isOffered: (process) => isRunning(process) && process.status !== "paused", question: PauseProcess }),
  on<ProcessView>("process", "resume", { icon: Play, permission: "runProcesses", isOffered: (process) => isRunning(process) && process.status === "paused", question: ResumeProcess }),
  on<ProcessView>("process", "cancel", { icon: Ban, permission: "runProcesses", isOffered: isRunning, question: Cancel }),
  on<ProcessView>("process", "migrate", { icon: GitBranch, permission: "runProcesses", isOffered: (process, entry) => isRunning(process) && ((entry(`definition/${process.definition}`)?.value as DefinitionView | undefined)?.version ?? 1) > 1, question: Migrate }),
  on<DefinitionView>("definition", "pauseAllOf", { icon: Pause, permission: "runProcesses", question: PauseProcess }),
  on<DefinitionView>("definition", "resumeAllOf", { icon: Play, permission: "runProcesses", question: ResumeProcess }),
  plain("pauseEverything", { icon: Pause, permission: "runProcesses", isOffered: runs("task-orchestrator"), question: PauseProcess }),
  plain("resumeEverything", { icon: Play, permission: "runProcesses", isOffered: runs("task-orchestrator"), question: ResumeProcess }),
  plain("upload", { icon: FileUp, permission: "deployProcesses", isOffered: runs("task-orchestrator"), address: pathOf({ kind: "upload" }) }),
  on<TasklistView>("task", "claim", { icon: Hand, permission: "performTasks", isOffered: ({ claimedBy, isClaimable }) => claimedBy === null && isClaimable, address: ({ id }) => addresses.tasks({ task: shortName(id) }) }),
  on<TasklistView>("task", "complete", { icon: BookOpenCheck, permission: "performTasks", isOffered: ({ claimedBy }) => claimedBy !== null && claimedBy === userName(), address: ({ id }) => addresses.tasks({ task: shortName(id) }) }),
  on<AlertView>("alert", "acknowledge", { icon: UserCheck, permission: "acknowledgeAlerts", isOffered: ({ acknowledged }) => acknowledged === null, question: Acknowledge }),
  on<{ id: string }>("robot", "control", { icon: Gamepad2, permission: "moveRobots", address: ({ id }) => addresses.robot(id, "control") }),
  on<string>("glove", "work", { icon: HardHat, permission: "performTasks", address: (glove) => addresses.work({ glove }) }),
  on<string>("glove", "calibrate", { icon: Ruler, permission: "configure", address: (glove) => addresses.glove(glove, "calibrate") }),
  on<string>("glove", "test", { icon: Ruler, permission: "configure", address: (glove) => addresses.glove(glove, "test") }),
  plain("addDevice", { icon: Cpu, permission: "configure", isOffered: runs("device-gateway"), address: addresses.devices({ add: "yes" }) }),
  ...THEMES,
  ...LANGUAGES,
  plain("soundOn", { icon: Volume2, isSetting: true, isOffered: () => !isSoundOn(), run: () => setSound(true) }),
  plain("soundOff", { icon: Volume2, isSetting: true, isOffered: isSoundOn, run: () => setSound(false) }),
  plain("keysOn", { icon: Keyboard, isSetting: true, isOffered: () => !areKeysOn(), run: () => setKeysOn(true) }),
  plain("keysOff", { icon: Keyboard, isSetting: true, isOffered: areKeysOn, run: () => setKeysOn(false) }),
  plain("preferences", { icon: SlidersHorizontal, isSetting: true, run: ({ showPreferences }) => showPreferences() }),
  plain("keyList", { icon: Keyboard, run: ({ showKeys }) => showKeys() }),
  // A station is signed out in its own menu, with a PIN.
  plain("signOut", { icon: LogOut, isOffered: () => { const { hasAccounts, user } = currentSession(); return hasAccounts && user?.isStation === false; }, run: signOut }),
];

/** Offer more acts until the returned function is called. */
export function addActs(acts: readonly Act[]): () => void {
  ACTS.push(...acts);
  return () => {
    for (const act of acts) ACTS.splice(ACTS.indexOf(act), 1);
  };
}

export function allActs(): readonly Act[] {
  return ACTS;
}

export function isObjectAct(act: Act): act is ObjectAct {
  return "of" in act;
}
