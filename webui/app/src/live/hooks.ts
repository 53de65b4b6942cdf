/** Hooks for live values. */
import i18next from "i18next";
import { createContext, useContext, useEffect, useMemo, useState, useSyncExternalStore } from "react";
import type { DefinitionView, ProcessView } from "~/api/generated/task-orchestrator";
import type { AlertView, DeviceView, GloveView, LiveEvent, RegisteredDeviceView, RegisteredDevicesView, RobotView, TasklistView, TopicValues } from "./messages";
import { processTextsOf, type ProcessTexts } from "./processTexts";
import { LiveStore, type ConnectionState } from "./store";

export const Live = createContext(new LiveStore());

export function useLive(): LiveStore {
  return useContext(Live);
}

/** The newest value of a topic; undefined while there is none. Texts of processes are in the language of the page. */
export function useTopic<T extends keyof TopicValues>(topic: T): TopicValues[T] | undefined {
  const live = useLive();
  const texts = useProcessTexts();
  const value = useSyncExternalStore(
    (listener) => live.watch(topic, listener),
    () => live.value(topic) as TopicValues[T] | undefined,
  );
  return OF_PROCESSES.has(topic.split("/")[0] ?? "") ? texts.localized(value) : value;
}

export interface Families {
  glove: GloveView;
  robot: RobotView;
  process: ProcessView;
  tasklist: TasklistView;
  definition: DefinitionView;
  alert: AlertView;
  device: DeviceView;
  registeredDevice: RegisteredDeviceView;
}

/** Families whose values have texts of BPMN files. */
const OF_PROCESSES: ReadonlySet<string> = new Set<keyof Families>(["definition", "glove", "process", "tasklist"]);

/** All values of a family, in the order of their names. Texts of processes are in the language of the page. */
export function useFamily<F extends keyof Families>(family: F): readonly Families[F][] {
  const texts = useProcessTexts();
  const values = useSentFamily(family);
  return OF_PROCESSES.has(family) ? texts.localized(values) : values;
}

/** The Tasks of people. Their texts are in the language of the page, as the definition of their process translates them. */
export function useTasklist(): readonly TasklistView[] {
  const texts = useProcessTexts();
  const tasks = useSentFamily("tasklist");
  const processes = useSentFamily("process");
  return useMemo(() => tasklistIn(texts, tasks, processes), [texts, tasks, processes]);
}

export function tasklistIn(texts: ProcessTexts, tasks: readonly TasklistView[], processes: readonly Pick<ProcessView, "id" | "definition">[]): readonly TasklistView[] {
  const definitions = new Map(processes.map(({ id, definition }) => [id, definition]));
  return tasks.map((task) => texts.of(definitions.get(task.process) ?? "").localized(task));
}

function useSentFamily<F extends keyof Families>(family: F): readonly Families[F][] {
  const live = useLive();
  return useSyncExternalStore(
    (listener) => live.watchFamily(family, listener),
    () => live.list(family) as readonly Families[F][],
  );
}

/** The texts of all definitions in the language of the page. */
export function useProcessTexts(): ProcessTexts {
  const definitions = useSentFamily("definition");
  const language = useSyncExternalStore(onLanguageChanged, () => i18next.language);
  return processTexts(definitions, language);
}

/** Shared by all components: what was translated is translated once. */
let shared: { definitions: readonly DefinitionView[]; language: string; texts: ProcessTexts } | null = null;

function processTexts(definitions: readonly DefinitionView[], language: string): ProcessTexts {
  if (shared?.definitions !== definitions || shared.language !== language) {
    shared = { definitions, language, texts: processTextsOf(definitions, language) };
  }
  return shared.texts;
}

function onLanguageChanged(listener: () => void): () => void {
  i18next.on("languageChanged", listener);
  return () => i18next.off("languageChanged", listener);
}

/** A value derived from a topic; renders only when it changes (compared by `Object.is`). */
export function useTopicSelector<T extends keyof TopicValues, P>(
  topic: T,
  pick: (value: TopicValues[T] | undefined) => P,
): P {
  const live = useLive();
  return useSyncExternalStore(
    (listener) => live.watch(topic, listener),
    () => pick(live.value(topic) as TopicValues[T] | undefined),
  );
}

/** A topic that is only sent while it is shown; `T` is its type in `messages.ts`. */
// eslint-disable-next-line @typescript-eslint/no-unnecessary-type-parameters -- the wire has no types
export function useSubscription<T>(topic: string | null): T | undefined {
  const live = useLive();
  useEffect(() => (topic === null ? undefined : live.subscribe(topic)), [live, topic]);
  return useSyncExternalStore(
    (listener) => (topic === null ? () => undefined : live.watch(topic, listener)),
    () => (topic === null ? undefined : (live.value(topic) as T | undefined)),
  );
}

/** Whether a snapshot was received since the page was opened, so that what is not there does not exist. */
export function useHasSnapshot(): boolean {
  useTopicSelector("services", (services) => services?.length ?? 0);
  return useLive().hasSnapshot;
}

/** All registered devices by name; null while they are loading. `isCurrent`: the device gateway answers. */
export function useRegisteredDevices(): { devices: readonly RegisteredDeviceView[] | null; isCurrent: boolean } {
  const state = useSubscription<RegisteredDevicesView>("registeredDevices");
  const devices = useFamily("registeredDevice");
  return { devices: state === undefined ? null : devices, isCurrent: state?.isCurrent ?? true };
}

export function useEvents(): readonly LiveEvent[] {
  const live = useLive();
  return useSyncExternalStore((listener) => live.watch("events", listener), () => live.events);
}

export function useConnectionState(): ConnectionState {
  const live = useLive();
  return useSyncExternalStore((listener) => live.watch("link", listener), () => live.link);
}

const LOOK_EVERY_MS = 50;

/** Whether the server has sent nothing for `limitMs`. While a component with this hook is shown, the server sends every 150 ms. */
export function useIsOld(limitMs: number): boolean {
  const live = useLive();
  const [isOld, setOld] = useState(false);
  useEffect(() => {
    const release = live.subscribe("pulse");
    const since = performance.now();
    const look = () => setOld(performance.now() - Math.max(live.receivedAtMs, since) > limitMs);
    // What arrived while this page itself was busy is read first.
    const timer = setInterval(() => setTimeout(look, 0), LOOK_EVERY_MS);
    return () => {
      clearInterval(timer);
      release();
    };
  }, [live, limitMs]);
  return isOld;
}
