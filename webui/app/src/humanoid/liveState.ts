/**
 * The live document of the humanoid over a WebSocket. Each document replaces the one before; while the connection is
 * lost it is opened again, and the last document ages.
 */
import { SERVICE, type LiveDocument } from "./humanoid";

const RETRY_MS = 500;
const MAX_RETRY_MS = 10_000;
/** A document that is older is not shown as live. */
export const OLD_MS = 1500;

export interface LiveSnapshot {
  phase: "connecting" | "open" | "lost" | "refused";
  document: LiveDocument | null;
  /** When the document came, by `performance.now()`. */
  receivedMs: number;
}

const NOTHING: LiveSnapshot = { phase: "connecting", document: null, receivedMs: 0 };

export class HumanoidLive {
  #snapshot = NOTHING;
  #socket: WebSocket | null = null;
  #retry: ReturnType<typeof setTimeout> | undefined;
  #retryMs = RETRY_MS;
  readonly #url: string;
  readonly #listeners = new Set<() => void>();

  /** Documents come `hz` times a second; a headset asks for as many as it draws. */
  constructor(hz = 30) {
    this.#url = socketUrl(`live?hz=${hz}`);
  }

  /** Connected while somebody listens; `listener` is called for each document. */
  readonly subscribe = (listener: () => void): (() => void) => {
    this.#listeners.add(listener);
    if (this.#listeners.size === 1) this.#connect();
    return () => {
      this.#listeners.delete(listener);
      if (this.#listeners.size === 0) this.#end();
    };
  };

  readonly snapshot = (): LiveSnapshot => this.#snapshot;

  #connect(): void {
    const socket = new WebSocket(this.#url);
    this.#socket = socket;
    socket.onmessage = ({ data }) => {
      this.#retryMs = RETRY_MS;
      this.#change({ phase: "open", document: JSON.parse(String(data)) as LiveDocument, receivedMs: performance.now() });
    };
    socket.onclose = ({ code }) => {
      if (this.#socket !== socket) return;
      this.#socket = null;
      this.#change({ ...this.#snapshot, phase: code === 4403 || code === 4401 ? "refused" : "lost" });
      this.#retry = setTimeout(() => this.#connect(), this.#retryMs);
      this.#retryMs = Math.min(2 * this.#retryMs, MAX_RETRY_MS);
    };
  }

  #end(): void {
    clearTimeout(this.#retry);
    const socket = this.#socket;
    this.#socket = null;
    socket?.close();
    this.#snapshot = NOTHING;
  }

  #change(snapshot: LiveSnapshot): void {
    this.#snapshot = snapshot;
    for (const listener of this.#listeners) listener();
  }
}

export function socketUrl(path: string): string {
  return `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/${SERVICE}/${path}`;
}
