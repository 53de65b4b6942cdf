/** How the states of Tasks, Processes, Devices and Alerts look: one place, so that every page agrees. */
import type { DeviceState, ServiceHealth, Severity, Status } from "~/live/messages";
import type { Tone } from "./State";

export const statusTone: Record<Status, Tone> = {
  pending: "neutral",
  assigned: "accent",
  inProgress: "accent",
  completed: "ok",
  paused: "attention",
  failed: "stop",
};

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

export const healthTone: Record<ServiceHealth["state"], Tone> = {
  up: "ok",
  degraded: "attention",
  down: "stop",
};
