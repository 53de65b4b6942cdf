/** The live state of a cell for tests: one glove, one robot, one definition, no running process. */
import type { DefinitionView, ProcessView, TaskView } from "~/api/generated/task-orchestrator";
import type { GloveTask, GloveView, RobotView, ServiceHealth } from "~/live/messages";
import * as views from "~/testing/views";
import type { Scene } from "./situation";

const at = "2026-01-01T10:00:00Z";

export const task: GloveTask = {
  id: "urn:ngsi-ld:Task:demo:bin-picking-1-confirm-1",
  description: "Confirm that the part lies free",
  gesture: "Thumbs up",
  code: "02222",
  commandId: 3,
  status: "inProgress",
};

export function glove(part: Partial<GloveView> = {}): GloveView {
  return {
    glove: "glove-1",
    hand: "right",
    person: null,
    connected: true,
    deviceState: "ok",
    battery: null,
    task: null,
    message: { key: "nothingToDo", values: {}, text: "No task for you." },
    hold: { gesture: null, heldMs: 0, announceMs: 500, confirmMs: 1500, spent: false },
    bend: null,
    states: "00000",
    gesture: null,
    differs: [],
    answered: null,
    testing: false,
    filtering: true,
    paused: false,
    lost: false,
    thresholds: {
      thumb: { upper: 1, lower: 0 },
      index: { upper: 1, lower: 0 },
      middle: { upper: 1, lower: 0 },
      ring: { upper: 1, lower: 0 },
      little: { upper: 1, lower: 0 },
    },
    frames: 0,
    dropped: 0,
    droppedBy: {},
    rate_hz: 50,
    ...part,
  };
}

export const robot: RobotView = {
  id: "ur10-1",
  device: "urn:ngsi-ld:Device:demo:ur10-1",
  model: "UR10",
  revision: "1",
  scene: "1",
  deviceState: "idle",
  joints: { stamp: 0, name: [], position: [], velocity: [] },
  toolPose: { position: [0, 0, 0], orientation: [0, 0, 0, 1] },
  gripper: { closed: false, holds: null, interrupted: null },
  task: null,
  operation: null,
  progress: null,
  remainingS: null, controlledBy: null, waitingForControl: [],
  awaitsConfirmation: false,
};

export const userTask: TaskView = views.task({
  id: task.id,
  element: "confirm",
  name: "Confirm",
  description: task.description,
  status: "inProgress",
  involves: ["urn:ngsi-ld:Device:demo:glove-1"],
  workParameters: { gesture: "Thumbs up" },
  createdAt: at,
  history: [],
});

export const robotTask: TaskView = {
  ...userTask,
  id: "urn:ngsi-ld:Task:demo:bin-picking-1-scan-1",
  element: "scan",
  name: "Scan the bin",
  involves: ["urn:ngsi-ld:Device:demo:ur10-1"],
  workParameters: { operation: "scan" },
};

export function process(part: Partial<ProcessView> = {}): ProcessView {
  return views.process({ startedAt: at, parameters: { operator: "Device:glove-1" }, done: 3, activities: 9, ...part });
}

export const completed = process({ status: "completed", endedAt: "2026-01-01T10:01:00Z" });
export const failed = process({
  status: "failed",
  endedAt: "2026-01-01T10:01:00Z",
  reason: "the robot could not pick",
  retry: robotTask.id,
});

export const stopped = process({
  incidents: [views.incident({ element: robotTask.element, name: robotTask.name, reason: "the robot could not pick", task: robotTask.id })],
  retry: robotTask.id,
});

export function definition(part: Partial<DefinitionView> = {}): DefinitionView {
  return { name: "bin-picking", version: 1, title: "Bin picking", label: null, deployedAt: at, parameters: [], holds: [], deletedVersions: [], translations: {}, ...part };
}

export function service(name: string, state: ServiceHealth["state"]): ServiceHealth {
  return { name, url: null, state, detail: null, since: at, rates: {}, lastMessage: null };
}

export function scene(part: Partial<Scene> = {}): Scene {
  return {
    link: "open",
    hasSnapshot: true,
    services: [],
    gloves: [glove()],
    robots: [robot],
    processes: [],
    definitions: [definition()],
    chosen: null,
    ...part,
  };
}
