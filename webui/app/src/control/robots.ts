/** The robots that a person can control: those of the trajectory tool, and those registered at the device gateway. */
import { useMemo } from "react";
import type { DeviceDetails, DeviceView } from "~/api/generated/device-gateway";
import { useServiceQuery } from "~/api/useServiceQuery";
import { useHasSnapshot, useTopic } from "~/live/hooks";
import { useRobotNames } from "~/live/names";
import type { JointDescription } from "~/robot/description";
import type { RobotService } from "./connection";

export interface ControlledRobot {
  service: RobotService;
  name: string;
}

export interface Lease {
  /** Who controls the robot. */
  holder: string | null;
  waiting: readonly { id: string; name: string }[];
}

const ROBOT_KINDS = ["robotArm", "mobileRobot", "humanoid"];
const ROBOTS_QUERY = `devices?${ROBOT_KINDS.map((kind) => `kind=${kind}`).join("&")}`;
const DEVICES_EVERY_MS = 5000;
const LEASE_EVERY_MS = 1000;
const NOBODY: Lease = { holder: null, waiting: [] };

/** All robots, those of the trajectory tool first; a name counts once. `isLoaded`: both services were asked. */
export function useRobots(): { robots: ControlledRobot[]; isLoaded: boolean } {
  const ofTool = useRobotNames();
  const hasSnapshot = useHasSnapshot();
  const { value, failure } = useServiceQuery<DeviceView[]>("device-gateway", ROBOTS_QUERY, { intervalMs: DEVICES_EVERY_MS });
  const robots = useMemo(() => robotsOf(ofTool, value ?? []), [ofTool, value]);
  return { robots, isLoaded: hasSnapshot && (value !== null || failure !== null) };
}

export function robotsOf(ofTool: readonly string[], devices: readonly Pick<DeviceView, "name" | "kind" | "connected">[]): ControlledRobot[] {
  const registered = devices.filter((one) => one.connected && ROBOT_KINDS.includes(one.kind) && !ofTool.includes(one.name));
  return [
    ...ofTool.map((name) => ({ service: "trajectory-tool" as const, name })),
    ...registered.map(({ name }) => ({ service: "device-gateway" as const, name })),
  ];
}

/** Who controls a robot of the trajectory tool. */
export function useToolLease(robot: string): Lease {
  const view = useTopic(`robot/${robot}`);
  return { holder: view?.controlledBy ?? null, waiting: view?.waitingForControl ?? [] };
}

/** Who controls a robot of the device gateway. */
export function useGatewayLease(robot: string): Lease {
  const { value } = useServiceQuery<Lease>("device-gateway", `robots/${encodeURIComponent(robot)}/control`, { intervalMs: LEASE_EVERY_MS });
  return value ?? NOBODY;
}

/** The joints of a registered robot, and whether it has a base that walks or rolls. */
export function useRegistered(robot: string): { joints: JointDescription[]; walks: boolean } {
  const { value } = useServiceQuery<DeviceDetails>("device-gateway", `devices/${encodeURIComponent(robot)}`);
  return useMemo(() => ({ joints: jointsOf(value), walks: value !== null && value.kind !== "robotArm" }), [value]);
}

/** The speed that the gateway uses for a joint without a registered one, before its fraction for hand control. */
const UNKNOWN_SPEED = 1;

export function jointsOf(device: Pick<DeviceDetails, "description"> | null): JointDescription[] {
  return (device?.description.joints ?? []).map((joint) => ({
    name: joint.name,
    type: joint.type ?? "revolute",
    unit: joint.type === "prismatic" ? "m" : "rad",
    lower: joint.lower ?? null,
    upper: joint.upper ?? null,
    maxVelocity: joint.maxVelocity ?? UNKNOWN_SPEED,
    labels: {},
  }));
}
