/**
 * The live signals of one person over a WebSocket: the state twice a second, and waveforms as they come.
 *
 * A person may read the own state without the permission for the WebSocket, so while that is not open the state is
 * asked for instead.
 */
import type { StateView } from "~/api/generated/human-state";
import { requestService } from "~/api/http";
import { wavePlace } from "./health";
import { isWave, keyOf, WaveBuffer, type Packet } from "./waveform";
import { pathOf, SERVICE } from "./health";

const RETRY_MS = 3000;
const MAX_RETRY_MS = 30_000;
const ASK_EVERY_MS = 1000;
const MAX_WAVES = 32;
/** The map is drawn at most so often. */
const MAP_EVERY_MS = 200;

export interface PressureMap {
  sensor: string;
  channels: readonly string[];
  values: readonly (number | null)[];
  receivedMs: number;
}

export interface LiveSnapshot {
  phase: "connecting" | "open" | "lost";
  /** Null without consent, and before the first message. */
  state: StateView | null;
  /** When the state came, in ms since 1970. */
  receivedMs: number;
  waves: readonly WaveBuffer[];
  maps: readonly PressureMap[];
}

const NOTHING: LiveSnapshot = { phase: "connecting", state: null, receivedMs: 0, waves: [], maps: [] };

interface Message {
  state?: StateView | null;
  signals?: Packet[];
}

export class LiveSignals {
  #snapshot = NOTHING;
  #socket: WebSocket | null = null;
  #retry: ReturnType<typeof setTimeout> | undefined;
  #asking: ReturnType<typeof setInterval> | undefined;
  #retryMs = RETRY_MS;
  readonly #person: string;
  readonly #url: string;
  readonly #listeners = new Set<() => void>();
  readonly #packetListeners = new Set<() => void>();

  constructor(person: string) {
    this.#person = person;
    this.#url = `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}/api/${SERVICE}/${pathOf(person)}/live`;
  }

  /** Connected while somebody listens. */
  readonly subscribe = (listener: () => void): (() => void) => {
    this.#listeners.add(listener);
    if (this.#listeners.size === 1) this.#connect();
    return () => {
      this.#listeners.delete(listener);
      if (this.#listeners.size === 0) this.#end();
    };
  };

  readonly snapshot = (): LiveSnapshot => this.#snapshot;

  /** Call `listener` for each packet of signals; the plots then draw in their own time. */
  onPackets(listener: () => void): () => void {
    this.#packetListeners.add(listener);
    return () => this.#packetListeners.delete(listener);
  }

  /** Take a message of the service. */
  take({ state, signals }: Message, nowMs: number): void {
    if (state !== undefined) {
      // Without consent nothing of the body stays on the screen.
      const signalsLeft = state === null ? { waves: [], maps: [] } : {};
      this.#change({ state, receivedMs: nowMs, ...signalsLeft });
    }
    for (const packet of signals ?? []) this.#takePacket(packet, nowMs);
    if (signals !== undefined) for (const listener of this.#packetListeners) listener();
  }

  #takePacket(packet: Packet, nowMs: number): void {
    if (packet.kind === "pressureMap") this.#takeMap(packet, nowMs);
    if (!isWave(packet)) return;
    const { waves } = this.#snapshot;
    const known = waves.find((wave) => keyOf(wave) === keyOf(packet));
    if (known?.takes(packet) === true) {
      known.push(packet, nowMs);
      return;
    }
    const others = waves.filter((wave) => wave !== known);
    if (others.length >= MAX_WAVES) return;
    const wave = new WaveBuffer(packet);
    wave.push(packet, nowMs);
    this.#change({ waves: [...others, wave].sort((a, b) => wavePlace(a.kind, a.sensor).localeCompare(wavePlace(b.kind, b.sensor))) });
  }

  #takeMap({ sensor, channels, values }: Packet, nowMs: number): void {
    const { maps } = this.#snapshot;
    const before = maps.find((map) => map.sensor === sensor);
    if (before !== undefined && nowMs - before.receivedMs < MAP_EVERY_MS) return;
    const map = { sensor, channels, values: values.map((column) => column.at(-1) ?? null), receivedMs: nowMs };
    this.#change({ maps: [...maps.filter((each) => each !== before), map].sort((a, b) => a.sensor.localeCompare(b.sensor)) });
  }

  #connect(): void {
    const socket = new WebSocket(this.#url);
    this.#socket = socket;
    socket.onmessage = ({ data }) => {
      if (this.#snapshot.phase !== "open") {
        clearInterval(this.#asking);
        this.#asking = undefined;
        this.#retryMs = RETRY_MS;
        this.#change({ phase: "open" });
      }
      this.take(JSON.parse(String(data)) as Message, Date.now());
    };
    socket.onclose = () => {
      if (this.#socket !== socket) return;
      this.#socket = null;
      this.#change({ phase: "lost" });
      this.#asking ??= setInterval(() => void this.#ask(), ASK_EVERY_MS);
      this.#retry = setTimeout(() => this.#connect(), this.#retryMs);
      this.#retryMs = Math.min(2 * this.#retryMs, MAX_RETRY_MS);
    };
  }

  async #ask(): Promise<void> {
    try {
      const state = await requestService<StateView>(SERVICE, `${pathOf(this.#person)}/state`);
      if (this.#asking !== undefined) this.take({ state }, Date.now());
    } catch {
      // What is shown ages, and is named stale.
    }
  }

  #end(): void {
    clearTimeout(this.#retry);
    clearInterval(this.#asking);
    this.#asking = undefined;
    const socket = this.#socket;
    this.#socket = null;
    socket?.close();
    this.#snapshot = NOTHING;
  }

  #change(change: Partial<LiveSnapshot>): void {
    this.#snapshot = { ...this.#snapshot, ...change };
    for (const listener of this.#listeners) listener();
  }
}
