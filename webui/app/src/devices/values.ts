/** Values of registered devices: their texts, and what is wrong with them. */
import { number } from "~/design/numbers";
import type { Tone } from "~/design/StatusBadge";
import type { DeviceSensor, DeviceValue, RegisteredDeviceView } from "~/live/messages";

/** A value of a sensor or a joint; `latest` is null before the first one. */
export interface ShownValue {
  name: string;
  unit: string | null;
  latest: DeviceValue | null;
  /** Null for a joint. */
  sensor: DeviceSensor | null;
}

export type Condition = "fault" | "away" | "outOfRange" | "stale" | "ok";

export const conditionTone: Record<Condition, Tone> = { fault: "stop", away: "neutral", outOfRange: "stop", stale: "attention", ok: "ok" };

/** The values of a device: its sensors as they are registered, then its joints. */
export function valuesOf(device: RegisteredDeviceView): ShownValue[] {
  const sensors = device.sensors.map((sensor) => ({ name: sensor.name, unit: sensor.unit, latest: device.values[sensor.name] ?? null, sensor }));
  const known = new Set(device.sensors.map((sensor) => sensor.name));
  const joints = Object.entries(device.values).filter(([name]) => !known.has(name));
  return [...sensors, ...joints.map(([name, latest]) => ({ name, unit: latest.unit, latest, sensor: null }))];
}

/** Whether a value is below or above the range of its sensor. */
export function outOfRange({ latest, sensor }: ShownValue): "below" | "above" | null {
  if (latest === null || sensor === null) return null;
  if (sensor.minimum !== null && latest.value < sensor.minimum) return "below";
  return sensor.maximum !== null && latest.value > sensor.maximum ? "above" : null;
}

/** The worst that is wrong with a device. A device that sends by HTTP has values without being connected. */
export function conditionOf(device: RegisteredDeviceView): Condition {
  const values = valuesOf(device);
  const fresh = values.filter(({ latest }) => latest !== null && !latest.stale);
  if (device.state === "error" || device.state === "outOfBattery") return "fault";
  if (!device.connected && fresh.length === 0) return "away";
  if (fresh.some((value) => outOfRange(value) !== null)) return "outOfRange";
  const isSilent = device.sensors.length > 0 && fresh.length === 0;
  return isSilent || values.some(({ latest }) => latest?.stale === true) ? "stale" : "ok";
}

export type ConnectionState = "open" | "away" | "expired" | "noAccess";

/** Whether a device is connected, and if not, whether it could identify itself: by its token or its certificate. */
export function connectionOf(device: RegisteredDeviceView, certificateEndsAt: number | null, nowMs: number): ConnectionState {
  if (device.connected) return "open";
  if (device.hasToken) return "away";
  if (certificateEndsAt === null) return "noAccess";
  return certificateEndsAt * 1000 > nowMs ? "away" : "expired";
}

/** "21.5" with four digits at most, but whole numbers in full. */
export function digits(value: number, language: string): string {
  return number(value, language, Math.abs(value) >= 1000 ? { maximumFractionDigits: 0 } : { maximumSignificantDigits: 4 });
}

/** "external force" of `externalForce` and of `external_force`. */
export function spaced(name: string): string {
  const words = name.replace(/([a-z\d])([A-Z])/g, "$1 $2").replace(/[_.-]+/g, " ");
  const lower = words.replace(/\b[A-Z](?=[a-z])/g, (letter) => letter.toLowerCase());
  return lower.charAt(0).toUpperCase() + lower.slice(1);
}

export function titleOf(device: { name: string; title: string }): string {
  return device.title === "" ? device.name : device.title;
}

/** A time of the device gateway, in seconds since 1970, as other times are written. */
export function isoOf(seconds: number): string {
  return new Date(seconds * 1000).toISOString();
}

/** The kind of the device gateway that a category of a Device entity stands for; undefined for one that says nothing. */
export function kindOfCategory(category: readonly string[]): string | undefined {
  const kinds: Readonly<Record<string, string>> = { robot: "robotArm", sensor: "sensor", actuator: "actuator", wearable: "wearable", camera: "camera", gripper: "gripper" };
  return category.flatMap((word) => kinds[word] ?? [])[0];
}
