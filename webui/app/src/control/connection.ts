/**
 * The control of a robot over a WebSocket: inputs 50 times a second, states 20 times a second.
 *
 * The service of the robot stops it when nothing arrives for 100 ms. So this sends nothing that is old: an input is
 * made when it is sent, and while the socket does not take it, nothing is added.
 */
import { RoundTrips, type Latency } from "./latency";

const SEND_EVERY_MS = 20;

export interface ControlInput {
  held: boolean;
  linear?: readonly number[];
  angular?: readonly number[];
  frame?: "cell" | "tool";
  joints?: readonly number[];
  mix?: number;
  arbitration?: boolean;
  gripper?: "open" | "close";
  gamma?: number;
}

/** The state that the service sends, as far as it is shown. */
export interface ControlState {
  seq: number;
  joints: { name: string[]; position: number[]; velocity: number[] };
  moves: boolean;
  needsRelease: boolean;
  limit: string | null;
  fault: string | null;
  holds: string | null;
  mix: number;
  goal: string | null;
  goalDistanceM: number | null;
  goals: Record<string, number>;
  confidence: number;
  inputAgeMs: number;
  isRecorded: boolean;
  stop: { beginMs: number; restMs: number } | null;
  latencyMs: number | null;
}

export type Phase = "off" | "connecting" | "waiting" | "on";

/** Why a motion ended: released, held without a direction, or by the service, although it was held. */
export type Stopped = "released" | "still" | "slow" | "limit" | "fault";

/** Why the motion before `state` ended, while the person holds the control or not. */
export function stoppedBy(state: Pick<ControlState, "fault" | "limit" | "needsRelease">, isHeld: boolean): Stopped {
  if (state.fault !== null) return "fault";
  if (!isHeld) return "released";
  // The service asks for a release after 100 ms without a message.
  if (state.needsRelease) return "slow";
  return state.limit === null ? "still" : "limit";
}

export interface ControlSnapshot {
  /** Why the last motion ended; null while the robot moves, and before it has. */
  stopped: Stopped | null;
  phase: Phase;
  /** Who has the control while this page waits. */
  holder: string | null;
  state: ControlState | null;
  error: string | null;
  latency: Latency;
  /** Why the last control ended; null if the user ended it. */
  ended: { code: number; reason: string } | null;
}

/** The service that moves the robot: the trajectory tool, or the device gateway for one that is registered there. */
export type RobotService = "trajectory-tool" | "device-gateway";

export type Mode = "refuse" | "wait" | "takeOver";

const OFF: ControlSnapshot = {
  stopped: null, phase: "off", holder: null, state: null, error: null, latency: { networkMs: null, networkMaxMs: null }, ended: null,
};

export class ControlConnection {
  #snapshot = OFF;
  #socket: WebSocket | null = null;
  #timer: ReturnType<typeof setInterval> | undefined;
  #seq = 0;
  #isHeld = false;
  #trips = new RoundTrips();
  readonly #listeners = new Set<() => void>();
  readonly #input: () => ControlInput;

  /** `input` makes the input that is sent now. */
  constructor(input: () => ControlInput) {
    this.#input = input;
  }

  readonly subscribe = (listener: () => void): (() => void) => {
    this.#listeners.add(listener);
    return () => this.#listeners.delete(listener);
  };

  readonly snapshot = (): ControlSnapshot => this.#snapshot;

  open(service: RobotService, robot: string, mode: Mode, record: boolean): void {
    this.close();
    const query = new URLSearchParams({ mode, record: String(record) });
    const url = `${location.origin.replace("http", "ws")}/api/${service}/robots/${encodeURIComponent(robot)}/control?${query.toString()}`;
    const socket = new WebSocket(url);
    this.#socket = socket;
    this.#seq = 0;
    this.#trips = new RoundTrips();
    this.#set({ ...OFF, phase: "connecting" });
    socket.onmessage = ({ data }) => this.#receive(JSON.parse(String(data)) as Record<string, unknown>);
    socket.onclose = ({ code, reason }) => this.#end({ code, reason });
    socket.onopen = () => {
      this.#timer = setInterval(() => this.send(), SEND_EVERY_MS);
    };
  }

  /** Send an input now. A release is sent at once, not at the next turn. */
  send(): void {
    const socket = this.#socket;
    if (socket?.readyState !== WebSocket.OPEN || socket.bufferedAmount > 0) return; // it would be old when it arrives
    const input = this.#input();
    this.#isHeld = input.held;
    this.#seq += 1;
    this.#trips.send(this.#seq, performance.now());
    socket.send(JSON.stringify({ seq: this.#seq, ...input }));
  }

  close(): void {
    const socket = this.#socket;
    if (socket === null) return;
    socket.onclose = socket.onmessage = socket.onopen = null;
    this.#end(null);
    socket.close(1000);
  }

  #receive(message: Record<string, unknown>): void {
    if (message["type"] === "waiting") {
      this.#set({ ...this.#snapshot, phase: "waiting", holder: message["holder"] as string | null });
    } else if (message["type"] === "error") {
      this.#set({ ...this.#snapshot, error: String(message["reason"]) });
    } else {
      const state = message as unknown as ControlState;
      this.#trips.receive(state.seq, state.inputAgeMs, performance.now());
      const { state: before, stopped: last } = this.#snapshot;
      const ended = before?.moves === true ? stoppedBy(state, this.#isHeld) : last;
      this.#set({ ...this.#snapshot, stopped: state.moves ? null : ended, phase: "on", state, latency: this.#trips.now(), error: state.moves ? null : this.#snapshot.error });
    }
  }

  #end(ended: ControlSnapshot["ended"]): void {
    clearInterval(this.#timer);
    this.#socket = null;
    this.#set({ ...OFF, ended });
  }

  #set(snapshot: ControlSnapshot): void {
    this.#snapshot = snapshot;
    for (const listener of this.#listeners) listener();
  }
}
