/** Icons and colours of the states of Tasks, Processes, Devices and Alerts, for all pages. */
import type { AlertPriority, AlertState, DeviceState, ServiceHealth, Severity, Status } from "~/live/messages";
import type { ProcessState } from "~/live/processState";
import type { Tone } from "./StatusBadge";

export const statusTone: Record<Status, Tone> = {
  pending: "neutral",
  assigned: "accent",
  inProgress: "accent",
  completed: "ok",
  paused: "attention",
  failed: "stop",
};

export const processTone: Record<ProcessState, Tone> = { ...statusTone, incident: "stop" };

export const deviceTone: Record<DeviceState, Tone> = {
  ok: "ok",
  idle: "ok",
  busy: "accent",
  paused: "attention",
  charging: "neutral",
  outOfBattery: "stop",
  forMaintenance: "attention",
  error: "stop",
};

export const severityTone: Record<Severity, Tone> = {
  informational: "accent",
  low: "neutral",
  medium: "attention",
  high: "attention",
  critical: "stop",
};

export const priorityTone: Record<AlertPriority, Tone> = {
  low: "neutral",
  medium: "attention",
  high: "attention",
  critical: "stop",
};

export const alertStateTone: Record<AlertState, Tone> = {
  new: "attention",
  acknowledged: "accent",
  shelved: "neutral",
  returnedToNormal: "ok",
};

export const healthTone: Record<ServiceHealth["state"], Tone> = {
  up: "ok",
  degraded: "attention",
  down: "stop",
};
