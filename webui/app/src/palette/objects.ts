/**
 * The objects of the live store as entries, kept up to date by what has changed: a value that is the same object as before keeps
 * its entries.
 */
import i18next from "i18next";
import { kindOf } from "~/alerts/attention";
import type { DefinitionView, ProcessView, TaskView } from "~/api/generated/task-orchestrator";
import { localizedText } from "~/i18n/server";
import type { AlertView, DeviceView, GloveView, RegisteredDeviceView, RobotView, ServiceHealth, TasklistView } from "~/live/messages";
import { processState } from "~/live/processState";
import { ProcessTexts } from "~/live/processTexts";
import type { LiveStore } from "~/live/store";
import { shortName } from "~/live/urn";
import { addresses } from "~/places/addresses";
import { pathOf } from "~/processes/address";
import { nameOf, taskMark } from "~/processes/names";
import { entryOf, type Entry, type EntryText } from "./entries";

type Source = (value: never, index: ObjectIndex) => EntryText[];

interface Family {
  name: string;
  source: Source;
  /** Its entries depend on those before, so that they are made again with each change. */
  isDependent?: true;
}

/** In this order, so that what names another object finds it. */
const FAMILIES: readonly Family[] = [
  { name: "definition", source: ofDefinition },
  { name: "process", source: ofProcess },
  { name: "tasklist", source: ofTask, isDependent: true },
  { name: "robot", source: ofRobot },
  { name: "glove", source: ofGlove },
  { name: "registeredDevice", source: ofRegisteredDevice },
  { name: "device", source: ofDevice, isDependent: true },
  { name: "alert", source: ofAlert, isDependent: true },
];
/** The families whose changes change entries. */
export const FAMILY_NAMES = FAMILIES.map(({ name }) => name);

const NO_TEXTS = new ProcessTexts(new Map());

export class ObjectIndex {
  readonly #live: LiveStore;
  #byValue = new Map<unknown, readonly Entry[]>();
  #entries: readonly Entry[] = [];
  #byId = new Map<string, Entry>();
  #lists: readonly (readonly unknown[])[] = [];
  #texts = NO_TEXTS;
  #language = "";
  readonly #said = new Map<string, string>();

  constructor(live: LiveStore) {
    this.#live = live;
  }

  /** All entries, each id once; the same array until something has changed. */
  get entries(): readonly Entry[] {
    return this.#entries;
  }

  get texts(): ProcessTexts {
    return this.#texts;
  }

  /** A text of the page, which many entries have. */
  say(key: string): string {
    const said = this.#said.get(key) ?? i18next.t(key);
    this.#said.set(key, said);
    return said;
  }

  entry(id: string): Entry | undefined {
    return this.#byId.get(id);
  }

  /** Take over what has changed in the live store, in `texts` or in the language of the page. */
  refresh(texts: ProcessTexts): void {
    const isSameText = texts === this.#texts && i18next.language === this.#language;
    const services = this.#live.value("services") ?? [];
    const lists = [...FAMILY_NAMES.map((family) => this.#live.list(family)), services];
    if (isSameText && lists.length === this.#lists.length && lists.every((list, nth) => list === this.#lists[nth])) return;
    this.#texts = texts;
    if (!isSameText) this.#said.clear();
    this.#language = i18next.language;
    this.#lists = lists;
    const known = this.#byValue;
    this.#byValue = new Map();
    this.#byId = new Map();
    const add = (value: unknown, source: Source, isDependent = false) => {
      const entries = (isSameText && !isDependent ? known.get(value) : undefined) ?? source(value as never, this).map(entryOf);
      this.#byValue.set(value, entries);
      for (const entry of entries) this.#byId.set(entry.id, entry);
    };
    FAMILIES.forEach(({ source, isDependent }, nth) => {
      for (const value of lists[nth] ?? []) add(value, source, isDependent);
    });
    for (const service of services) add(service, ofService);
    this.#entries = [...this.#byId.values()];
  }
}

const indexes = new WeakMap<LiveStore, ObjectIndex>();

/** The index of a live store, which is kept while the palette is closed, so that it opens at once. */
export function indexOf(live: LiveStore): ObjectIndex {
  const index = indexes.get(live) ?? new ObjectIndex(live);
  indexes.set(live, index);
  return index;
}

function ofDefinition(definition: DefinitionView, { texts }: ObjectIndex): EntryText[] {
  const { name, version, title } = definition;
  const address = pathOf({ kind: "definition", name });
  return [{ id: `definition/${name}`, kind: "definition", name: texts.of(name).say(title), detail: i18next.t("palette:version", { version }), address, more: [name, title], value: definition }];
}

function ofProcess(process: ProcessView, index: ObjectIndex): EntryText[] {
  const { texts } = index;
  const { id, definition, version, key } = process;
  const { name } = texts.localized({ name: process.name, title: process.title, definition, version });
  const entry: EntryText = {
    id: `process/${id}`,
    kind: "process",
    name,
    detail: index.say(`common:processStatus.${processState(process)}`),
    address: addresses.process(id),
    more: [id, definition, key ?? ""],
    value: process,
  };
  return [entry, ...process.tasks.map((task) => ofProcessTask(process, name, task, texts))];
}

function ofProcessTask(process: ProcessView, processName: string, task: TaskView, texts: ProcessTexts): EntryText {
  const address = `${addresses.process(process.id)}?task=${encodeURIComponent(taskMark(task))}`;
  const name = texts.of(process.definition).say(nameOf(task));
  return { id: `task/${shortName(task.id)}`, kind: "task", name, detail: processName, address, more: [processName, shortName(task.id)] };
}

/** A Task for people has a page of its own, and replaces that within its process. */
function ofTask(task: TasklistView, index: ObjectIndex): EntryText[] {
  const id = shortName(task.id);
  const process = index.entry(`process/${task.process}`);
  const definition = (process?.value as ProcessView | undefined)?.definition ?? "";
  const detail = process?.name ?? "";
  return [{ id: `task/${id}`, kind: "task", name: index.texts.of(definition).say(task.name), detail, address: addresses.tasks({ task: id }), more: [detail, id, ...task.groups], value: task }];
}

function ofRobot(robot: RobotView): EntryText[] {
  return [{ id: `robot/${robot.id}`, kind: "robot", name: robot.id, detail: robot.model, address: addresses.robot(robot.id), more: [robot.model], value: robot }];
}

function ofGlove({ glove, person }: GloveView): EntryText[] {
  const detail = person === null ? "" : shortName(person);
  return [{ id: `glove/${glove}`, kind: "glove", name: glove, detail, address: addresses.glove(glove), more: [detail], value: glove }];
}

function ofRegisteredDevice({ name, title, kind, location }: RegisteredDeviceView): EntryText[] {
  const shown = title === "" ? name : title;
  return [{ id: `device/${name}`, kind: "device", name: shown, detail: location ?? "", address: addresses.device(name), more: [name, kind, location ?? ""] }];
}

/** A Device of the broker; a glove, a robot and a registered device have a page of their own. */
function ofDevice({ id, category, deviceState }: DeviceView, index: ObjectIndex): EntryText[] {
  const name = shortName(id);
  if (["robot", "glove", "device"].some((kind) => index.entry(`${kind}/${name}`) !== undefined)) return [];
  const detail = deviceState === null ? "" : i18next.t(`common:deviceState.${deviceState}`);
  return [{ id: `entity/${id}`, kind: "device", name, detail, address: addresses.cell({ find: name }), more: category }];
}

function ofAlert(alert: AlertView, index: ObjectIndex): EntryText[] {
  const kind = kindOf(alert);
  const name = kind === "other" ? (localizedText(alert, "description") ?? alert.description) : i18next.t(`common:alertKind.${kind}`);
  const source = shortName(alert.source);
  const detail = index.entry(`process/${source}`)?.name ?? index.entry(`task/${source}`)?.name ?? source;
  return [{ id: `alert/${alert.id}`, kind: "alert", name, detail, address: addresses.alerts({ alert: alert.id }), more: [detail, shortName(alert.id)], value: alert }];
}

function ofService({ name, state }: ServiceHealth): EntryText[] {
  const detail = i18next.t(`common:health.${state}`);
  return [{ id: `service/${name}`, kind: "service", name: i18next.t(`common:services.${name}`, { defaultValue: name }), detail, address: addresses.services(), more: [name] }];
}
