/**
 * The objects of the cell as rows of a list: robots, gloves, devices, sensors, services, and Devices that exist only in the context broker.
 *
 * A Device entity in the broker, a device of the gateway and a robot of the trajectory tool may be the same object: it is
 * listed once, by the service that knows most about it.
 */
import type { ProcessView } from "~/api/generated/task-orchestrator";
import { deviceTone, healthTone } from "~/design/states";
import type { Tone } from "~/design/StatusBadge";
import { conditionOf, conditionTone, titleOf } from "~/devices/values";
import type { AlertView, DeviceView, GloveView, RegisteredDeviceView, RobotView, ServiceHealth } from "~/live/messages";
import { shortName } from "~/live/urn";
import { addresses } from "~/places/addresses";

export const OBJECT_KINDS = ["robot", "glove", "device", "sensor", "other", "service"] as const;
export type ObjectKind = (typeof OBJECT_KINDS)[number];

interface Common {
  key: string;
  /** The name in the address. */
  name: string;
  title: string;
  /** The URN of its Device entity; null if it has none or it is not known. */
  entity: string | null;
  address: string;
  tone: Tone;
  alerts: number;
  needsAttention: boolean;
  battery: number | null;
  /** When its values were last observed, ISO 8601. */
  seenAt: string | null;
}

export type CellObject = Common &
  (
    | { kind: "robot"; view: RobotView | null; registered: RegisteredDeviceView | null }
    | { kind: "glove"; view: GloveView }
    | { kind: "device" | "sensor"; view: RegisteredDeviceView }
    | { kind: "other"; view: DeviceView }
    | { kind: "service"; view: ServiceHealth }
  );

export interface Sources {
  robots: readonly RobotView[];
  gloves: readonly GloveView[];
  registered: readonly RegisteredDeviceView[];
  /** Whether the device gateway was asked: before, a Device of the broker may be one of its own. */
  isRegisteredKnown: boolean;
  devices: readonly DeviceView[];
  services: readonly ServiceHealth[];
  alerts: AlertCounts;
}

export const ROBOT_KINDS: readonly string[] = ["robotArm", "mobileRobot", "humanoid"];
/** Kinds of the device gateway that measure, and do nothing else. */
const SENSOR_KINDS: readonly string[] = ["sensor", "wearable", "camera"];

/** All objects, in the order of `OBJECT_KINDS`, each kind by name. */
export function objectsOf(sources: Sources): CellObject[] {
  const { robots, gloves, registered, devices } = sources;
  const byName = new Map(registered.map((device) => [device.name, device]));
  const ofTool = new Set(robots.map(({ id }) => id));
  const gloveDevices = new Map(devices.filter(({ category }) => category.includes("glove")).map((device) => [shortName(device.id), device.id]));
  const listed = new Set([...robots.map(({ device }) => device), ...registered.map(({ entity }) => entity), ...gloves.flatMap(({ glove }) => gloveDevices.get(glove) ?? [])]);
  const objects: Record<ObjectKind, CellObject[]> = { robot: [], glove: [], device: [], sensor: [], other: [], service: [] };
  for (const view of robots) objects.robot.push(robotOf(view, byName.get(view.id) ?? null, sources.alerts));
  for (const view of gloves) objects.glove.push(gloveOf(view, gloveDevices.get(view.glove) ?? null, sources.alerts));
  for (const view of registered) {
    if (!ofTool.has(view.name)) {
      const object = registeredOf(view, sources.alerts);
      objects[object.kind].push(object);
    }
  }
  if (sources.isRegisteredKnown) {
    const others = devices.filter(({ id }) => !listed.has(id));
    const nameOf = namesOf(others, new Set([...byName.keys(), ...ofTool]));
    for (const view of others) objects.other.push(otherOf(view, nameOf(view), sources.alerts));
  }
  for (const view of sources.services) objects.service.push(serviceOf(view, sources.alerts));
  return OBJECT_KINDS.flatMap((kind) => objects[kind]);
}

/**
 * The names of Devices of the broker in addresses: the last part of the URN, or the URN where another object has that name.
 */
export function namesOf(devices: readonly DeviceView[], taken: ReadonlySet<string>): (device: DeviceView) => string {
  const counts = new Map<string, number>();
  for (const { id } of devices) counts.set(shortName(id), (counts.get(shortName(id)) ?? 0) + 1);
  return ({ id }) => (counts.get(shortName(id)) === 1 && !taken.has(shortName(id)) ? shortName(id) : id);
}

/** Whether every word of `find` is in the name, the title or the kind of an object, as people see it. */
export function matches(object: CellObject, find: string, kindName: string): boolean {
  const text = `${object.name} ${object.title} ${kindName}`.toLowerCase();
  return find.toLowerCase().split(/\s+/).every((word) => text.includes(word));
}

function robotOf(view: RobotView, registered: RegisteredDeviceView | null, counts: AlertCounts): CellObject {
  const alerts = counts.of(view.device, view.id);
  const tone = deviceTone[view.deviceState];
  return {
    kind: "robot", key: `robot ${view.id}`, name: view.id, title: view.id, entity: view.device, address: addresses.robot(view.id), tone, alerts,
    needsAttention: isBad(tone) || alerts > 0, battery: registered?.batteryLevel ?? null, seenAt: null, view, registered,
  };
}

function gloveOf(view: GloveView, entity: string | null, counts: AlertCounts): CellObject {
  const alerts = counts.of(entity, view.glove);
  // A glove that nobody wears may lie in its charger.
  const tone: Tone = view.connected ? deviceTone[view.deviceState] : view.person === null ? "neutral" : "attention";
  return {
    kind: "glove", key: `glove ${view.glove}`, name: view.glove, title: view.glove, entity, address: addresses.glove(view.glove), tone, alerts,
    needsAttention: isBad(tone) || view.lost || alerts > 0, battery: view.battery, seenAt: null, view,
  };
}

function registeredOf(view: RegisteredDeviceView, counts: AlertCounts) {
  const alerts = counts.of(view.entity, view.name);
  const condition = conditionOf(view);
  const tone = condition === "fault" && view.state !== null ? deviceTone[view.state] : conditionTone[condition];
  const common = {
    name: view.name, title: titleOf(view), entity: view.entity, address: addresses.device(view.name), tone, alerts, needsAttention: condition !== "ok" || alerts > 0,
    battery: view.batteryLevel, seenAt: view.seenAt === null ? null : new Date(view.seenAt * 1000).toISOString(),
  };
  if (ROBOT_KINDS.includes(view.kind)) return { ...common, kind: "robot" as const, key: `robot ${view.name}`, view: null, registered: view };
  const kind = SENSOR_KINDS.includes(view.kind) ? ("sensor" as const) : ("device" as const);
  return { ...common, kind, key: `registered ${view.name}`, view };
}

function otherOf(view: DeviceView, name: string, counts: AlertCounts): CellObject {
  const alerts = counts.of(view.id, "");
  const tone = view.deviceState === null ? "neutral" : deviceTone[view.deviceState];
  return {
    kind: "other", key: view.id, name, title: shortName(view.id), entity: view.id, address: addresses.device(name), tone, alerts,
    needsAttention: isBad(tone) || alerts > 0, battery: view.batteryLevel, seenAt: view.observedAt, view,
  };
}

function serviceOf(view: ServiceHealth, counts: AlertCounts): CellObject {
  const alerts = counts.of(null, view.name);
  return {
    kind: "service", key: `service ${view.name}`, name: view.name, title: view.name, entity: null, address: addresses.service(view.name), tone: healthTone[view.state], alerts,
    needsAttention: view.state !== "up" || alerts > 0, battery: null, seenAt: null, view,
  };
}

function isBad(tone: Tone): boolean {
  return tone === "attention" || tone === "stop";
}

/** An Alert that somebody still has to deal with, or deals with. */
export function isOpen({ state }: AlertView): boolean {
  return state === "new" || state === "acknowledged";
}

type TaskOfProcess = Pick<ProcessView["tasks"][number], "id" | "involves">;

/** What Alerts are about: their source, and if that is a Task, the objects that it involves. */
export function subjectsOf(source: string, tasks: ReadonlyMap<string, TaskOfProcess>): readonly string[] {
  return [source, ...(tasks.get(source)?.involves ?? [])];
}

export function tasksOf(processes: readonly { tasks: readonly TaskOfProcess[] }[]): ReadonlyMap<string, TaskOfProcess> {
  return new Map(processes.flatMap(({ tasks }) => tasks.map((task) => [task.id, task] as const)));
}

/** Whether an Alert or a Task about `subject` is about the object with this entity, or, where it is not known, with this name. */
export function isAbout(subject: string, entity: string | null, name: string): boolean {
  return entity === null ? shortName(subject) === name : subject === entity;
}

/** The numbers of open Alerts by the URN of what they are about, and by its short name. */
export class AlertCounts {
  readonly #byUrn = new Map<string, number>();
  readonly #byName = new Map<string, number>();

  constructor(alerts: readonly AlertView[], tasks: ReadonlyMap<string, TaskOfProcess>) {
    for (const alert of alerts.filter(isOpen)) {
      for (const subject of new Set(subjectsOf(alert.source, tasks))) {
        this.#byUrn.set(subject, (this.#byUrn.get(subject) ?? 0) + 1);
        this.#byName.set(shortName(subject), (this.#byName.get(shortName(subject)) ?? 0) + 1);
      }
    }
  }

  of(entity: string | null, name: string): number {
    return (entity === null ? this.#byName.get(name) : this.#byUrn.get(entity)) ?? 0;
  }
}
