/** Tasks and processes for tests, in the format of the orchestrator. */
import type { IncidentView, ProcessView, TaskView } from "~/api/generated/task-orchestrator";
import type { TasklistView } from "~/live/messages";

const START = Date.parse("2026-03-02T08:00:00Z");

export function at(seconds: number): string {
  return new Date(START + seconds * 1000).toISOString();
}

export function atMs(seconds: number): number {
  return START + seconds * 1000;
}

export function task(over: Partial<TaskView> = {}): TaskView {
  return {
    id: "urn:ngsi-ld:Task:demo:bin-picking-1-pick-1",
    element: "pick",
    name: "Pick the part",
    visit: 1,
    description: null,
    status: "pending",
    involves: ["urn:ngsi-ld:Device:demo:ur10-1"],
    workParameters: {},
    outputParameters: null,
    createdAt: at(0),
    deadline: null,
    priority: null,
    dueDate: null,
    followUpDate: null,
    endedAt: null,
    cancelled: false,
    allocated: null,
    reason: null,
    history: [{ status: "pending", at: at(0) }],
    ...over,
  };
}

export function process(over: Partial<ProcessView> = {}): ProcessView {
  return {
    id: "bin-picking-1",
    entity: "urn:ngsi-ld:Process:demo:bin-picking-1",
    definition: "bin-picking",
    version: 1,
    name: "Bin picking 1",
    title: "Bin picking",
    number: 1,
    key: null,
    status: "inProgress",
    reason: null,
    startedAt: at(0),
    endedAt: null,
    archivedAt: null,
    parameters: {},
    variables: {},
    waiting: [],
    next: [],
    afterNext: [],
    done: 0,
    activities: 11,
    elements: {},
    tasks: [],
    incidents: [],
    retries: [],
    unallocated: [],
    reservations: [],
    tokens: [],
    scopes: [],
    retry: null,
    acts: [],
    ...over,
  };
}

export function incident(over: Partial<IncidentView> = {}): IncidentView {
  return {
    token: "7",
    element: "pick",
    name: "Pick the part",
    reason: "the gripper is empty",
    since: at(30),
    task: "urn:ngsi-ld:Task:demo:bin-picking-1-pick-1",
    code: null,
    ...over,
  };
}

/** A Task in the tasklist that is offered to everybody. */
export function listedTask(over: Partial<TasklistView> = {}): TasklistView {
  return {
    id: "urn:ngsi-ld:Task:demo:p-1-weigh-2", name: "Weigh", description: null, process: "p-1", element: "weigh", status: "pending",
    persons: [], groups: [], claimedBy: null, declinedBy: [], isClaimable: true, since: at(0), deadline: null, dueDate: null,
    followUpDate: null, priority: null, ...over,
  };
}
