/**
 * The control of a robot over a WebSocket: inputs 50 times a second, states 20 times a second.
 *
 * The service of the robot stops it when nothing arrives for 100 ms. So this sends nothing that is old: an input is
 * made when it is sent, and while the socket does not take it, nothing is added.
 */
import { DelayHistory, RoundTrips, type Latency } from "./latency";

const SEND_EVERY_MS = 20;
/** After this time without a state, which comes 20 times a second, what is shown is old. */
export const OLD_AFTER_MS = 400;
const KEPT_STOPS = 5;

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

/** The end of a motion; `ended`: the control itself ended. */
export interface Stop {
  /** In ms since 1970. */
  at: number;
  why: Stopped | "ended";
}

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
  /** The last stops, the newest first. */
  stops: readonly Stop[];
  /** Whether the last state is older than `OLD_AFTER_MS` while this page has the control. */
  isOld: boolean;
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
  stopped: null, stops: [], isOld: false, phase: "off", holder: null, state: null, error: null, latency: { networkMs: null, networkMaxMs: null }, ended: null,
};

function withStop(stops: readonly Stop[], why: Stop["why"]): readonly Stop[] {
  return [{ at: Date.now(), why }, ...stops].slice(0, KEPT_STOPS);
}

export class ControlConnection {
  #snapshot = OFF;
  #socket: WebSocket | null = null;
  #timer: ReturnType<typeof setInterval> | undefined;
  #seq = 0;
  #isHeld = false;
  #receivedAtMs = 0;
  #trips = new RoundTrips();
  readonly delays = new DelayHistory();
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
    this.#set({ ...OFF, stops: this.#snapshot.stops, phase: "connecting" });
    socket.onmessage = ({ data }) => this.#receive(JSON.parse(String(data)) as Record<string, unknown>);
    socket.onclose = ({ code, reason }) => this.#end({ code, reason });
    socket.onopen = () => {
      this.#timer = setInterval(() => {
        this.send();
        setTimeout(() => this.#look(), 0); // what arrived while this page itself was busy is read first
      }, SEND_EVERY_MS);
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
      this.#receivedAtMs = performance.now();
      this.delays.push(this.#receivedAtMs, this.#trips.receive(state.seq, state.inputAgeMs, this.#receivedAtMs), state.latencyMs);
      const { state: before, stopped: last, stops } = this.#snapshot;
      const ended = before?.moves === true ? stoppedBy(state, this.#isHeld) : last;
      const stopsNow = before?.moves === true && !state.moves && ended !== null ? withStop(stops, ended) : stops;
      this.#set({
        ...this.#snapshot,
        stopped: state.moves ? null : ended,
        stops: stopsNow,
        isOld: false,
        phase: "on",
        state,
        latency: this.#trips.now(),
        error: state.moves ? null : this.#snapshot.error,
      });
    }
  }

  #look(): void {
    if (this.#snapshot.phase !== "on" || this.#snapshot.isOld) return;
    if (performance.now() - this.#receivedAtMs > OLD_AFTER_MS) this.#set({ ...this.#snapshot, isOld: true });
  }

  #end(ended: ControlSnapshot["ended"]): void {
    clearInterval(this.#timer);
    this.#socket = null;
    const { state, stops } = this.#snapshot;
    this.#set({ ...OFF, stops: state?.moves === true ? withStop(stops, "ended") : stops, ended });
  }

  #set(snapshot: ControlSnapshot): void {
    this.#snapshot = snapshot;
    for (const listener of this.#listeners) listener();
  }
}
