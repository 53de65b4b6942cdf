/** The objects of the cell, updated at most once a second. */
import { useMemo } from "react";
import { useHasSnapshot, useSubscription, useTopic } from "~/live/hooks";
import type { RegisteredDevicesView, ServiceHealth } from "~/live/messages";
import { useSampledFamily } from "~/live/sampled";
import { AlertCounts, objectsOf, tasksOf, type CellObject } from "./cellObjects";

const NO_SERVICES: readonly ServiceHealth[] = [];
export const GATEWAY = "device-gateway";

export interface CellObjects {
  objects: readonly CellObject[];
  /** Whether all sources were read, so that what is not listed does not exist. */
  isLoaded: boolean;
  /** The device gateway answers, or there is none. */
  isGatewayCurrent: boolean;
}

export function useCellObjects(): CellObjects {
  const gateway = useSubscription<RegisteredDevicesView>("registeredDevices");
  const services = useTopic("services") ?? NO_SERVICES;
  const robots = useSampledFamily("robot");
  const gloves = useSampledFamily("glove");
  const registered = useSampledFamily("registeredDevice");
  const devices = useSampledFamily("device");
  const alerts = useSampledFamily("alert");
  const processes = useSampledFamily("process");
  const hasSnapshot = useHasSnapshot();
  const hasGateway = services.some(({ name }) => name === GATEWAY);
  const isRegisteredKnown = gateway !== undefined || (hasSnapshot && !hasGateway);
  const counts = useMemo(() => new AlertCounts(alerts, tasksOf(processes)), [alerts, processes]);
  const objects = useMemo(
    () => objectsOf({ robots, gloves, registered, isRegisteredKnown, devices, services, alerts: counts }),
    [robots, gloves, registered, isRegisteredKnown, devices, services, counts],
  );
  return { objects, isLoaded: hasSnapshot && isRegisteredKnown, isGatewayCurrent: gateway?.isCurrent !== false || !hasGateway };
}
