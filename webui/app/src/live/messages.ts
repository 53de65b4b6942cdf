/**
 * What the one WebSocket (`/api/live`) carries. The server's side of it is `webui/live.py`.
 *
 * A topic has one value, and only its newest counts; `null` says that the thing is gone. Events are never
 * left out: their `seq` rises by one, and a gap is filled from `GET /api/events?after=`.
 */

export type Status = "pending" | "assigned" | "inProgress" | "completed" | "paused" | "failed";
export type DeviceState =
  | "ok" | "idle" | "busy" | "paused" | "charging" | "outOfBattery" | "forMaintenance" | "error";
export type Severity = "informational" | "low" | "medium" | "high" | "critical";
export type Finger = "thumb" | "index" | "middle" | "ring" | "little";

/** `services`: one row a component; `rates` are per second, by what is counted. */
export interface ServiceHealth {
  name: string;
  state: "up" | "degraded" | "down";
  /** Why it is not up, in the service's own words. */
  detail: string | null;
  since: string;
  rates: Record<string, number>;
  lastMessage: { at: string; text: string } | null;
}

/** `glove/<name>`: the gesture controller's view of a glove. */
export interface GloveView {
  glove: string;
  hand: "left" | "right";
  person: string | null;
  connected: boolean;
  deviceState: DeviceState;
  battery: number | null;
  task: GloveTask | null;
  message: Message;
  /** `spent`: the gesture that is held has counted already; it must be let go before it can count again. */
  hold: {
    gesture: string | null;
    heldMs: number;
    announceMs: number;
    confirmMs: number;
    spent: boolean;
    /** What the gesture would answer to the Task; null if it is none of its answers. */
    outcome?: Outcome | null;
  };
  bend: number[] | null;
  states: string | null;
  gesture: string | null;
  differs: Finger[];
  /** The last answer given with this hand or on its screen; it stays until the next one. */
  answered: {
    task: string;
    gesture: string | null;
    by: "gesture" | "screen";
    operator: string | null;
    outcome?: Outcome;
    note?: string | null;
  } | null;
  testing: boolean;
  filtering: boolean;
  paused: boolean;
  lost: boolean;
  thresholds: Record<Finger, { upper: number; lower: number }>;
  /** While filtering is off: what that means. */
  warning?: Message | null;
  /** What reads the hand, and what it lacks if it cannot (then the thresholds do). */
  recognizer?: { name: string; missing: string | null };
  /** Why a new calibration is due (the levels have jumped, or drifted too far); null while none is. */
  calibrationNeeded?: string | null;
  /** The calibration that is on its way, or how the last one ended. */
  calibration?: GuideView | null;
  /** The accuracy test that is being done with it. */
  examination?: Examination | null;
  frames: number;
  dropped: number;
  droppedBy: Record<string, number>;
  rate_hz: number;
}

/** A calibration as the hand is led through it. */
export interface GuideView {
  step: "fist" | "open" | "gesture";
  steps: ("fist" | "open" | "gesture")[];
  phase: "countdown" | "capture" | "done" | "givenUp" | "interrupted";
  gesture: string | null;
  /** The shape to show: five finger states. */
  code: string;
  /** Of the countdown, or of the second that the hand must be still. */
  remainingMs: number;
  /** The fingers that were not still in the last second. */
  restless: Finger[];
  message: Message;
  outcome: { applied: boolean; problem: string | null; doubts: FingerDoubt[] } | null;
}

/** A finger that is not to be relied on. */
export interface FingerDoubt {
  finger: Finger;
  why: "dead" | "saturated" | "wrongWay" | "smallSpan" | "noisy";
  advice: string;
}

/** What the screen shows of an accuracy test that is on its way; `round` counts from 1. */
export interface Examination {
  id: string;
  phase: "break" | "rest" | "asked" | "noted" | "interrupted" | "stopped" | "finished";
  reason: string;
  asked: { gesture: string; code: string } | null;
  done: number;
  trials: number;
  round: number;
  rounds: number;
  heldMs: number;
  holdMs: number;
  askedForMs: number;
  limitMs: number;
  last: { asked: string; outcome: "right" | "corrected" | "missed"; first: string; recognizedMs: number | null } | null;
}

export interface GloveTask {
  id: string;
  description: string;
  gesture: string;
  /** Five finger states, thumb first: 0 straight, 1 between, 2 bent; of a composed gesture, those due of this hand. */
  code: string;
  commandId: number | null;
  /** What a gesture of both hands, or of two in turn, consists of, and how far each part is; none of a single one. */
  parts?: GesturePart[];
  /** The answers other than `ok`; `gesture` is null where only the screen can give one. */
  answers?: AnswerOption[];
  status: Status;
}

/** What a person answers to a Task. */
export type Outcome = "ok" | "notGood" | "problem";

export interface AnswerOption {
  outcome: Outcome;
  gesture: string | null;
  code: string | null;
}

/** One of the two that a composed gesture consists of; `hand` is null where they are shown in turn by one. */
export interface GesturePart {
  gesture: string;
  code: string;
  hand: "left" | "right" | null;
  state: "done" | "held" | "now" | "next";
}

/** What the controller says: `key` and `values` for the page's own languages, `text` in English. */
export interface Message {
  key: string;
  values: Record<string, string | number | string[]>;
  text: string;
}

/** `robot/<id>`: the trajectory tool's view of a robot, some times a second. */
export interface RobotView {
  id: string;
  device: string;
  deviceState: DeviceState;
  joints: JointState;
  toolPose: { position: number[]; orientation: number[] };
  gripper: { closed: boolean; holds: string | null };
  task: string | null;
  operation: string | null;
  progress: number | null;
  remainingS: number | null;
}

/** `robot/<id>/joints`: only for pages that want it (see `Want`), up to 30 times a second; may lose some. */
export interface JointState {
  stamp: number;
  name: string[];
  position: number[];
  velocity: number[];
}

/** `process/<id>`: every process that has not ended, and the last ten that have. */
export interface ProcessView {
  id: string;
  entity: string;
  definition: string;
  version: number;
  /** The process's name for people, "Bin picking". */
  title: string;
  key: string | null;
  status: Status;
  reason: string | null;
  startedAt: string;
  endedAt: string | null;
  parameters: Record<string, unknown>;
  variables: Record<string, unknown>;
  /** The BPMN elements that hold a token now. */
  waiting: string[];
  /** The activities that may come after those, the likeliest first. */
  next: Activity[];
  /** How far it is: activities done at least once, of all that the definition has. */
  done: number;
  activities: number;
  /** Per BPMN activity. */
  elements: Record<string, ElementCount>;
  tasks: TaskView[];
  /** Whether somebody can retry, and which Task. */
  retry: string | null;
  /** What people did with it, the oldest first. */
  acts: Act[];
}

/** Somebody cancelled a process (`by` may be unknown), or had its failed `task` retried. */
export interface Act {
  at: string;
  by: string | null;
  act: "cancel" | "retry";
  task: string | null;
}

export interface Activity {
  element: string;
  name: string;
  description: string | null;
  lane: string | null;
  /** The URNs of the resources it involves, as far as they are known by now. */
  involves: string[];
}

export interface ElementCount {
  running: number;
  completed: number;
  failed: number;
  /** How long the last one, and the median of all, took from creation to its end. */
  lastMs: number | null;
  medianMs: number | null;
}

export interface TaskView {
  id: string;
  element: string;
  name: string;
  visit: number;
  description: string | null;
  status: Status;
  involves: string[];
  workParameters: Record<string, unknown>;
  outputParameters: Record<string, unknown> | null;
  createdAt: string;
  deadline: string | null;
  endedAt: string | null;
  cancelled: boolean;
  /** Why it failed, for people; `wordsIn` says it in the language of the page. */
  reason: string | null;
  reasonCode?: string;
  reasonParameters?: Record<string, unknown>;
  history: { status: Status; at: string }[];
}

/** `definition/<name>`: the latest version of each. */
export interface DefinitionView {
  name: string;
  version: number;
  title: string;
  label: string | null;
  deployedAt: string;
  /** Why it cannot run any more, if so. */
  unusable?: string;
  parameters: { name: string; required: boolean; default: unknown }[];
}

/** How soon a person must respond. */
export type AlertPriority = "low" | "medium" | "high" | "critical";

/** After ISA-18.2. */
export type AlertState = "new" | "acknowledged" | "shelved" | "returnedToNormal";

/** `alert/<urn>`: those that are active, and the last fifty that are over. */
export interface AlertView {
  id: string;
  category: string;
  subCategory: string | null;
  severity: Severity;
  priority: AlertPriority;
  state: AlertState;
  /** When the state was written, if that is known. */
  stateAt: string | null;
  /** In English; `wordsIn` says it in the language of the page. */
  description: string;
  descriptionCode?: string | null;
  descriptionParameters?: Record<string, unknown>;
  source: string;
  dateIssued: string;
  validTo: string | null;
  /** When the last shelving ends, or has ended. */
  shelvedUntil: string | null;
  shelvedBy: string | null;
  acknowledged: { by: string; at: string } | null;
}

/** `device/<urn>`: the Device entities in the broker, key-values. */
export interface DeviceView {
  id: string;
  category: string[];
  deviceState: DeviceState | null;
  batteryLevel: number | null;
  observedAt: string | null;
  value: unknown;
}

/** `operator`: the simulated operator that this page can start. */
export interface OperatorView {
  running: boolean;
  glove: string;
  detail: string | null;
}

/** Something that happened, for the event log: `key` and `values` for the page's languages, `text` in English. */
export interface LiveEvent {
  seq: number;
  at: string;
  level: "info" | "attention" | "stop";
  source: string;
  key: string;
  values: Record<string, string | number>;
  text: string;
}

export interface TopicValues {
  services: ServiceHealth[];
  operator: OperatorView;
  /** What the cell is called, which version runs, and where the real emergency stop is, if the site has said so. */
  cell: { factory: string; version: string; emergencyStop?: string };
  [glove: `glove/${string}`]: GloveView;
  [robot: `robot/${string}`]: RobotView;
  [process: `process/${string}`]: ProcessView;
  [definition: `definition/${string}`]: DefinitionView;
  [alert: `alert/${string}`]: AlertView;
  [device: `device/${string}`]: DeviceView;
}

/** Server to page. A snapshot holds everything: what it does not name is gone. */
export interface Batch {
  type: "snapshot" | "batch";
  at: string;
  topics: Record<string, unknown>;
  events: LiveEvent[];
}

/** Page to server: the topics beyond the usual ones (`robot/ur10-1/joints`) that the page shows now. */
export interface Want {
  type: "want";
  topics: string[];
}
