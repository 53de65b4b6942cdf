/**
 * The link to the server: one WebSocket that comes back by itself. After every break the server sends a
 * snapshot, so that nothing is shown that is no longer so.
 */
import type { Batch, LiveEvent, Want } from "./messages";
import type { LiveStore } from "./store";

const FIRST_RETRY_MS = 250;
const LAST_RETRY_MS = 5000;
/** The server says something at least every five seconds; silence for longer is a broken link. */
const SILENCE_MS = 12_000;

export interface ConnectionOptions {
  url: string;
  /** Fetches events after a `seq`, when the link has left some out. */
  fetchEvents: (after: number) => Promise<LiveEvent[]>;
}

export class Connection {
  readonly #store: LiveStore;
  readonly #options: ConnectionOptions;
  #socket: WebSocket | null = null;
  #retryMs = FIRST_RETRY_MS;
  #retry: ReturnType<typeof setTimeout> | undefined;
  #silence: ReturnType<typeof setTimeout> | undefined;
  #ended = false;

  constructor(store: LiveStore, options: ConnectionOptions) {
    this.#store = store;
    this.#options = options;
    store.onWant = () => this.#sendWant();
    addEventListener("online", this.#again);
    document.addEventListener("visibilitychange", this.#again);
    this.#connect();
  }

  close(): void {
    this.#ended = true;
    removeEventListener("online", this.#again);
    document.removeEventListener("visibilitychange", this.#again);
    clearTimeout(this.#retry);
    clearTimeout(this.#silence);
    this.#socket?.close();
  }

  readonly #again = (): void => {
    if (this.#socket === null && !this.#ended && !document.hidden) {
      clearTimeout(this.#retry);
      this.#connect();
    }
  };

  #connect(): void {
    const socket = new WebSocket(this.#options.url);
    this.#socket = socket;
    socket.onopen = () => {
      this.#retryMs = FIRST_RETRY_MS;
      this.#listen(socket);
      this.#sendWant();
    };
    socket.onmessage = (message: MessageEvent<string>) => {
      this.#listen(socket);
      this.#take(JSON.parse(message.data) as Batch);
    };
    socket.onclose = () => this.#lost(socket);
  }

  #listen(socket: WebSocket): void {
    clearTimeout(this.#silence);
    this.#silence = setTimeout(() => {
      // A cable that was pulled never says goodbye, and closing would wait for it.
      socket.onclose = null;
      socket.close();
      this.#lost(socket);
    }, SILENCE_MS);
  }

  #lost(socket: WebSocket): void {
    if (this.#socket !== socket) return;
    this.#socket = null;
    clearTimeout(this.#silence);
    if (this.#ended) return;
    this.#store.setLink("lost");
    this.#retry = setTimeout(() => this.#connect(), this.#retryMs);
    this.#retryMs = Math.min(2 * this.#retryMs, LAST_RETRY_MS);
  }

  #take(batch: Batch): void {
    const last = this.#store.events.at(-1)?.seq;
    const first = batch.events[0]?.seq;
    this.#store.take(batch);
    this.#store.setLink("open");
    if (last !== undefined && first !== undefined && first > last + 1) {
      void this.#options.fetchEvents(last).then(
        (events) => this.#store.takeEvents(events),
        () => undefined, // the link is lost again: the next gap asks anew
      );
    }
  }

  #sendWant(): void {
    if (this.#socket?.readyState !== WebSocket.OPEN) return;
    const want: Want = { type: "want", topics: this.#store.wanted };
    this.#socket.send(JSON.stringify(want));
  }
}
