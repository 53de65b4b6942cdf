/** The last seconds of a signal, for a plot: times, and a column for each channel. */

export interface Packet {
  sensor: string;
  kind: string;
  unit: string;
  rateHz: number | null;
  /** In s since 1970. */
  startS: number;
  endS: number;
  channels: readonly string[];
  /** By channel; null was not measured. */
  values: readonly (readonly (number | null)[])[];
}

export const WAVE_S = 10;
const MAX_POINTS = 40_000;
/** In periods. A longer pause breaks the line. */
const GAP = 2.5;
/** Slower signals are values, which have a history. */
const LEAST_HZ = 5;

export function isWave({ kind, rateHz }: Packet): boolean {
  return kind !== "pressureMap" && rateHz !== null && rateHz >= LEAST_HZ;
}

export const keyOf = ({ sensor, kind }: Pick<Packet, "sensor" | "kind">) => `${sensor} ${kind}`;

export class WaveBuffer {
  readonly kind: string;
  readonly sensor: string;
  readonly unit: string;
  readonly channels: readonly string[];
  /** When the newest packet came, on the clock of the page in ms. */
  receivedMs = 0;
  #times: number[] = [];
  #columns: (number | null)[][];

  constructor(first: Packet) {
    this.kind = first.kind;
    this.sensor = first.sensor;
    this.unit = first.unit;
    this.channels = first.channels;
    this.#columns = first.channels.map(() => []);
  }

  /** The time of the newest sample in s since 1970; -Infinity before the first one. */
  get endS(): number {
    return this.#times.at(-1) ?? -Infinity;
  }

  /** Whether a packet continues this signal; one of other channels or another unit does not. */
  takes({ unit, channels }: Packet): boolean {
    return unit === this.unit && channels.length === this.channels.length && channels.every((name, index) => name === this.channels[index]);
  }

  /** Add a packet. One that begins before the newest sample clears the signal: the clock of the sensor was set back. */
  push(packet: Packet, nowMs: number): void {
    const { rateHz, startS, values } = packet;
    const count = Math.min(values[0]?.length ?? 0, MAX_POINTS);
    if (rateHz === null || count === 0 || !Number.isFinite(startS)) return;
    this.receivedMs = nowMs;
    if (startS <= this.endS) this.#clear();
    if (startS - this.endS > GAP / rateHz && this.#times.length > 0) this.#add((this.endS + startS) / 2, () => null);
    for (let index = 0; index < count; index++) this.#add(startS + index / rateHz, (channel) => values[channel]?.[index] ?? null);
    this.#trim();
  }

  columns(): [number[], ...(number | null)[][]] {
    return [this.#times, ...this.#columns];
  }

  #add(timeS: number, value: (channel: number) => number | null): void {
    this.#times.push(timeS);
    this.#columns.forEach((column, channel) => column.push(value(channel)));
  }

  #clear(): void {
    this.#times = [];
    this.#columns = this.#columns.map(() => []);
  }

  /** Drop what is out of the plot; a margin, so that the line reaches its edge. */
  #trim(): void {
    const from = this.endS - WAVE_S - 1;
    let drop = Math.max(0, this.#times.length - MAX_POINTS);
    while ((this.#times[drop] ?? Infinity) < from) drop++;
    if (drop === 0) return;
    this.#times.splice(0, drop);
    for (const column of this.#columns) column.splice(0, drop);
  }
}
