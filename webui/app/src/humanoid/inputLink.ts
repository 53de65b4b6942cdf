/**
 * What a person sends to the humanoid: wishes of the therapist, or poses and pulls of the patient.
 *
 * Nothing old is sent: a message is made when it is sent, and while the socket does not take it, none is added. The
 * service lets the robot stand when nothing arrives.
 */
import { socketUrl } from "./liveState";
import type { Place, Rotation, Side } from "./humanoid";

const RETRY_MS = 1000;

export interface WishMessage {
  kind: "wish";
  /** Velocities in m/s and rad/s, which count while `held`. */
  ahead: number;
  left: number;
  yaw: number;
  held: boolean;
}

export interface PoseMessage {
  kind: "pose";
  /** The time of the sender in s, which the echo repeats. */
  t: number;
  headset: { position: Place; rotation: Rotation } | null;
  hands: Record<Side, { position: Place; rotation: Rotation; grip: number } | null>;
  tracking: "ok" | "lost";
  inBounds: boolean;
  /** The person has recentred the view, which moves all places at once. */
  recentred?: boolean;
}

/** Forces on the hands of the robot by a person, by the robot's side, in N; null lets go. */
export interface PullMessage {
  kind: "pull";
  left: Place | null;
  right: Place | null;
}

export type InputMessage = WishMessage | PoseMessage | PullMessage;

export type Answer =
  | { kind: "echo"; t: number }
  | { kind: "walked"; ahead: number; left: number; yaw: number; because: string }
  | { kind: "haptic"; hand: Side; intensity: number; ms: number }
  | { kind: "error"; reason: string; reasonCode?: string; reasonParameters?: Record<string, unknown> };

export class InputLink {
  #socket: WebSocket | null = null;
  #retry: ReturnType<typeof setTimeout> | undefined;
  #isClosed = false;
  readonly #url: string;
  readonly #onAnswer: (answer: Answer) => void;

  constructor(role: "patient" | "therapist", onAnswer: (answer: Answer) => void = () => undefined) {
    this.#url = socketUrl(`input?role=${role}`);
    this.#onAnswer = onAnswer;
    this.#connect();
  }

  get isOpen(): boolean {
    return this.#socket?.readyState === WebSocket.OPEN;
  }

  /** Send a message now; returns whether it was sent. */
  send(message: InputMessage): boolean {
    const socket = this.#socket;
    if (socket?.readyState !== WebSocket.OPEN || socket.bufferedAmount > 0) return false;
    socket.send(JSON.stringify(message));
    return true;
  }

  close(): void {
    this.#isClosed = true;
    clearTimeout(this.#retry);
    this.#socket?.close();
    this.#socket = null;
  }

  #connect(): void {
    const socket = new WebSocket(this.#url);
    this.#socket = socket;
    socket.onmessage = ({ data }) => this.#onAnswer(JSON.parse(String(data)) as Answer);
    socket.onclose = () => {
      if (this.#isClosed || this.#socket !== socket) return;
      this.#socket = null;
      this.#retry = setTimeout(() => this.#connect(), RETRY_MS);
    };
  }
}
