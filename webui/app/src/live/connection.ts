/**
* The connection to the server: one WebSocket that reconnects by itself. After each reconnection the server
* sends a snapshot, so that no stale value is shown.
 */
import type { Batch, LiveEvent, SubscribeMessage } from "./messages";
import type { LiveStore } from "./store";

const MIN_RETRY_MS = 250;
const MAX_RETRY_MS = 5000;
/** The server sends at least once a second. After this time without a message the page says that it is out of date. */
export const SILENT_AFTER_MS = 2200;
/** After this time without a message the connection is broken. */
const BROKEN_AFTER_MS = 12_000;

export interface LiveConnectionOptions {
  url: string;
  /** Fetches events after a `seq`, to fill a gap. */
  /** The connection was closed: perhaps the session of the user has ended. */
  onClosed?: () => void;
  fetchEvents: (after: number) => Promise<LiveEvent[]>;
}

export class LiveConnection {
  readonly #store: LiveStore;
  readonly #options: LiveConnectionOptions;
  #socket: WebSocket | null = null;
  #retryMs = MIN_RETRY_MS;
  #retry: ReturnType<typeof setTimeout> | undefined;
  #silence: ReturnType<typeof setTimeout> | undefined;
  #timeout: ReturnType<typeof setTimeout> | undefined;
  #isClosed = false;

  constructor(store: LiveStore, options: LiveConnectionOptions) {
    this.#store = store;
    this.#options = options;
    store.onSubscriptionsChange = () => this.#sendSubscriptions();
    addEventListener("online", this.#reconnect);
    document.addEventListener("visibilitychange", this.#reconnect);
    this.#connect();
  }

  close(): void {
    this.#isClosed = true;
    removeEventListener("online", this.#reconnect);
    document.removeEventListener("visibilitychange", this.#reconnect);
    clearTimeout(this.#retry);
    clearTimeout(this.#silence);
    clearTimeout(this.#timeout);
    this.#socket?.close();
  }

  readonly #reconnect = (): void => {
    if (this.#socket === null && !this.#isClosed && !document.hidden) {
      clearTimeout(this.#retry);
      this.#connect();
    }
  };

  #connect(): void {
    const socket = new WebSocket(this.#options.url);
    this.#socket = socket;
    socket.onopen = () => {
      this.#retryMs = MIN_RETRY_MS;
      this.#restartTimeout(socket);
      this.#sendSubscriptions();
    };
    socket.onmessage = (message: MessageEvent<string>) => {
      this.#restartTimeout(socket);
      this.#receive(JSON.parse(message.data) as Batch);
    };
    socket.onclose = () => {
      this.#options.onClosed?.();
      this.#onClose(socket);
    };
  }

  #restartTimeout(socket: WebSocket): void {
    clearTimeout(this.#silence);
    clearTimeout(this.#timeout);
    this.#silence = setTimeout(() => {
      // Messages that arrived while this page itself was busy are read first.
      this.#silence = setTimeout(() => this.#onSilence(), 0);
    }, SILENT_AFTER_MS);
    this.#timeout = setTimeout(() => {
      // After an unplugged cable no close frame arrives, so do not wait for it.
      socket.onclose = null;
      socket.close();
      this.#onClose(socket);
    }, BROKEN_AFTER_MS);
  }

  /** The server does not send. It may be slow only, so the connection stays: the next message makes it `open` again. */
  #onSilence(): void {
    if (this.#store.link === "open") this.#store.setLink("lost");
  }

  #onClose(socket: WebSocket): void {
    if (this.#socket !== socket) return;
    this.#socket = null;
    clearTimeout(this.#silence);
    clearTimeout(this.#timeout);
    if (this.#isClosed) return;
    this.#store.setLink("lost");
    this.#retry = setTimeout(() => this.#connect(), this.#retryMs);
    this.#retryMs = Math.min(2 * this.#retryMs, MAX_RETRY_MS);
  }

  #receive(batch: Batch): void {
    const last = this.#store.events.at(-1)?.seq;
    const first = batch.events[0]?.seq;
    this.#store.apply(batch);
    this.#store.setLink("open");
    if (last !== undefined && first !== undefined && first > last + 1) {
      void this.#options.fetchEvents(last).then(
        (events) => this.#store.addEvents(events),
        () => undefined, // the connection is lost again: the next gap is fetched later
      );
    }
  }

  #sendSubscriptions(): void {
    if (this.#socket?.readyState !== WebSocket.OPEN) return;
    const message: SubscribeMessage = { type: "subscribe", topics: this.#store.subscriptions };
    this.#socket.send(JSON.stringify(message));
  }
}
