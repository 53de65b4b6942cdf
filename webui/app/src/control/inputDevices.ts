/** Input devices of the device gateway, and the mapping of their axes, which each user keeps by device. */
import type { InputMapping } from "~/api/generated/device-gateway";
import { DIRECTIONS, MAX_GAMMA, MIN_GAMMA, type Direction } from "./mapping";

/** What the values of the axes are: velocities of a stick, or positions of a hand that the tool follows. */
export type AxisKind = "rate" | "position";

export interface NamedAxis {
  axis: string;
  sense: 1 | -1;
}

export interface DeviceMapping {
  gamma: number;
  kind: AxisKind;
  axes: Partial<Record<Direction, NamedAxis>>;
}

/** The mappings of a user, by the name of the device. */
export interface DeviceMappings {
  devices: Record<string, DeviceMapping>;
}

export const NO_MAPPINGS: DeviceMappings = { devices: {} };
const DEAD_ZONE = 0.05;
/** The speed of the tool for an axis at 1, in m/s and rad/s. */
const TOOL_MPS = 0.25;
const TOOL_RPS = 1;

export function isMappings(value: unknown): value is DeviceMappings {
  const devices = (value as Partial<DeviceMappings> | null)?.devices;
  return typeof devices === "object" && (devices as unknown) !== null && Object.values(devices).every(isMapping);
}

function isMapping(value: unknown): value is DeviceMapping {
  if (typeof value !== "object" || value === null) return false;
  const { gamma, kind, axes } = value as Partial<DeviceMapping>;
  if (typeof gamma !== "number" || gamma < MIN_GAMMA || gamma > MAX_GAMMA) return false;
  if ((kind !== "rate" && kind !== "position") || typeof axes !== "object") return false;
  return Object.entries(axes).every(([direction, use]) => (DIRECTIONS as readonly string[]).includes(direction) && typeof use.axis === "string" && Math.abs(use.sense) === 1);
}

/** The first mapping of a device: an axis whose name ends with a direction moves that one. */
export function initialMapping(names: readonly string[]): DeviceMapping {
  const axes: DeviceMapping["axes"] = {};
  for (const direction of DIRECTIONS) {
    const axis = names.find((name) => wordsOf(name).at(-1) === direction);
    if (axis !== undefined) axes[direction] = { axis, sense: 1 };
  }
  return { gamma: 1, kind: "rate", axes };
}

/** "stick", "x" of `stickX`; `rx` stays one word. */
function wordsOf(name: string): string[] {
  return name.replaceAll(/([a-z0-9])([A-Z])/g, "$1 $2").toLowerCase().split(/[ _.-]+/);
}

/** The mapping as the gateway takes it; null for a device without axes, which sends velocities itself. */
export function gatewayMapping({ kind, axes }: DeviceMapping, names: readonly string[]): InputMapping | null {
  if (names.length === 0) return null;
  const found: InputMapping = {};
  for (const [nth, direction] of DIRECTIONS.entries()) {
    const use = axes[direction];
    if (use === undefined) continue;
    const speed = kind === "position" ? 1 : nth < 3 ? TOOL_MPS : TOOL_RPS;
    found[direction] = { axis: use.axis, scale: use.sense * speed, kind, deadZone: kind === "rate" ? DEAD_ZONE : 0 };
  }
  return found;
}
