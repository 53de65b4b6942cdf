/** The state of a person: how its values are shown, and which of them may be trusted. */
import type { HistoryPoint, LimitView, PersonView, Purpose, SensorStateView, StateView, ValueView } from "~/api/generated/human-state";
import { number, percent } from "~/design/numbers";
import type { Tone } from "~/design/StatusBadge";

export const SERVICE = "human-state";
export const PURPOSES: readonly Purpose[] = ["live", "speedLimits", "history", "broker", "brokerHistory", "recording"];
export const DAY_MS = 86_400_000;
export const DEFAULT_CONSENT_DAYS = 30;
export const MAX_CONSENT_DAYS = 365;
/** Without a message for so long, what is shown is old: the service sends twice a second. */
export const SILENT_S = 3;

export const pathOf = (person: string) => `people/${encodeURIComponent(person)}`;

/** In the order in which they are shown; others follow. */
const ORDER = ["heartRate", "breathingRate", "exertionLevel", "spo2", "hrvRmssd", "hrvSdnn", "hrvLfHf", "skinTemperature", "stress", "fatigue", "edaTonic", "edaPhasic", "emgEnvelope", "movement", "steps", "cadence", "blinkRate", "blinkDuration", "fixationDuration", "saccadeRate", "saccadeAmplitude", "pupilDiameter"];
/** They have a card of their own. */
export const POSITIONS = ["activity", "dailyActivity", "posture", "sleepPosition"] as const;
const NOT_VITAL = new Set<string>([...POSITIONS, "copX", "copY", "load", "activeCells"]);
const SHARES = new Set(["exertionLevel", "stress", "fatigue"]);
/** Sensors send them from 0 to 100. */
const PERCENTAGES = new Set(["spo2", "bodyMovement"]);
const SYMBOLS: Record<string, string> = { BPM: "bpm", C94: "/min", C26: "ms", P1: "%", D80: "µS", D82: "µV", "2Z": "mV", C62: "", MSK: "m/s²", "2A": "rad/s", CEL: "°C", MMT: "mm", HTZ: "Hz", DD: "°", OHM: "Ω", NEW: "N", NU: "N m", D81: "µT", MLT: "ml", L2: "l/min" };
const DIGITS: Record<string, number> = { heartRate: 0, hrvRmssd: 0, hrvSdnn: 0, steps: 0, cadence: 0, movement: 3, edaTonic: 2, edaPhasic: 2, blinkRate: 0, blinkDuration: 0, fixationDuration: 0, pupilDiameter: 2 };

export function vitalSigns(state: StateView): ValueView[] {
  const place = ({ name }: ValueView) => (ORDER.indexOf(name) + ORDER.length + 1) % (ORDER.length + 1);
  return state.values.filter(({ name }) => !NOT_VITAL.has(name)).sort((a, b) => place(a) - place(b) || a.name.localeCompare(b.name));
}

/** Waveforms in the order in which they are shown: those of heart and breath first. */
const WAVES = ["ecg", "ppg", "respiration", "eda", "emg", "eeg"];

/** Sorts waveforms: by signal, then by sensor. */
export function wavePlace(kind: string, sensor: string): string {
  return `${String((WAVES.indexOf(kind) + WAVES.length + 1) % (WAVES.length + 1))} ${kind} ${sensor}`;
}

/** The features of which a history can be drawn. */
export const DRAWN = ["heartRate", "breathingRate", "exertionLevel", "hrvRmssd", "spo2", "skinTemperature", "stress", "fatigue", "movement", "bodyMovement"] as const;

export function symbolOf(name: string, unit: string | null): string {
  return SHARES.has(name) || PERCENTAGES.has(name) ? "" : unit === null ? "" : (SYMBOLS[unit] ?? unit);
}

/** The value without its unit; a share is written with its percent sign. */
export function numberText(name: string, value: number, language: string): string {
  if (SHARES.has(name)) return percent(value, language);
  if (PERCENTAGES.has(name)) return percent(value / 100, language);
  return number(value, language, { maximumFractionDigits: DIGITS[name] ?? 1, signDisplay: "negative" });
}

export type Trust = "valid" | "weak" | "stale" | "implausible";
export const trustTone: Record<Trust, Tone> = { valid: "ok", weak: "attention", stale: "attention", implausible: "stop" };
const LEAST_QUALITY = 0.5;

/** Whether a value may be trusted. One that was not refreshed since `silentS` ago is stale, whatever it was then. */
export function trustOf(value: ValueView, silentS: number): Trust {
  if (value.status === "implausible") return "implausible";
  if (value.status !== "valid" || silentS > SILENT_S) return "stale";
  return value.quality < LEAST_QUALITY ? "weak" : "valid";
}

/** What is wrong with a sensor; null when nothing is. */
export function sensorFault({ link, hasContact, fault }: SensorStateView): { kind: "link" | "contact" | "fault"; what: string } | null {
  if (link !== null && link !== "connected") return { kind: "link", what: link };
  if (hasContact === false) return { kind: "contact", what: "noContact" };
  return fault === null ? null : { kind: "fault", what: fault };
}

export interface Reason {
  key: "none" | "noLimit" | "high" | "normal" | "rising" | "silent" | "other";
  seconds: number;
  text: string;
}

/** Why the limit is what it is, of the text of the service; "other" for a text that is not known. */
export function reasonOf({ reason }: Pick<LimitView, "reason">): Reason {
  const text = /^stopped; a person must reset it \((.*)\)$/.exec(reason)?.[1] ?? reason;
  const silent = /^no valid heart rate for (\d+) s$/.exec(text);
  if (silent !== null) return { key: "silent", seconds: Number(silent[1]), text };
  const keys: Record<string, Reason["key"]> = { "no heart rate yet": "none", "no limit received from human state yet": "noLimit", "the heart rate is high": "high", "the heart rate is normal": "normal", "the heart rate is normal, and the limit rises slowly": "rising" };
  return { key: keys[text] ?? "other", seconds: 0, text };
}

export function limitTone({ fraction, isStopped }: LimitView): Tone {
  return isStopped || fraction === 0 ? "stop" : fraction < 1 ? "attention" : "ok";
}

/** The consent is valid now: something is processed. */
export function consents(person: PersonView): boolean {
  return person.purposes.includes("live");
}

/** Why nothing is processed. */
export function consentState({ consent, purposes }: PersonView): "valid" | "none" | "withdrawn" | "ended" {
  if (purposes.includes("live")) return "valid";
  if (consent === null) return "none";
  return consent.withdrawn === null ? "ended" : "withdrawn";
}

/** What a route gives or changes, as keys of texts. */
const ACCESSED: Record<string, string> = {
  "GET /people/{person}": "overview",
  "PUT /people/{person}": "change",
  "GET /people/{person}/state": "state",
  "WebSocket /people/{person}/live": "live",
  "WebSocket /people/{person}/values": "live",
  "GET /people/{person}/limit": "limit",
  "POST /people/{person}/limit/reset": "reset",
  "GET /people/{person}/history/{feature}": "history",
  "GET /people/{person}/history/{feature}/points": "history",
  "GET /people/{person}/history/{feature}/durations": "history",
  "GET /people/{person}/recordings": "recordings",
  "GET /people/{person}/recordings/{recording}/file": "download",
  "GET /people/{person}/recordings/{recording}/xdf": "download",
  "GET /people/{person}/recordings/{recording}/bundle": "download",
  "POST /people/{person}/recordings": "record",
  "POST /people/{person}/recordings/{recording}/stop": "stop",
  "POST /people/{person}/recordings/{recording}/markers": "mark",
  "DELETE /people/{person}/recordings/{recording}": "deleteRecording",
  "PUT /people/{person}/consent": "consent",
  "DELETE /people/{person}/consent": "withdraw",
  "DELETE /people/{person}/data": "deleteData",
  "POST /people/{person}/baseline/rest": "baseline",
  "POST /people/{person}/baseline/maximum": "baseline",
  "PUT /sensors/{sensor}": "sensor",
  "DELETE /sensors/{sensor}": "sensor",
};

/** The key of the text for an action of the audit log; null for one that is not known. */
export function accessKey(action: string): string | null {
  return ACCESSED[action] ?? null;
}

/** "2026-05-04", for a field of a date, in the time zone of the reader. */
export function dateText(ms: number): string {
  const date = new Date(ms);
  return `${date.getFullYear()}-${String(date.getMonth() + 1).padStart(2, "0")}-${String(date.getDate()).padStart(2, "0")}`;
}

/** The end of a day of a field; null for another text. */
export function endOfDay(text: string): string | null {
  const parts = /^(\d{4})-(\d{2})-(\d{2})$/.exec(text);
  if (parts === null) return null;
  const end = new Date(Number(parts[1]), Number(parts[2]) - 1, Number(parts[3]), 23, 59, 59);
  return Number.isNaN(end.getTime()) || dateText(end.getTime()) !== text ? null : end.toISOString();
}

/** What is wrong with the fields of a consent, as keys of texts. */
export function consentFaults(fields: { name: string; age: string; ends: string; givenBy: string }, isNew: boolean, nowMs: number): Partial<Record<keyof typeof fields, true>> {
  const age = Number(fields.age.replace(",", "."));
  const end = endOfDay(fields.ends);
  const days = end === null ? NaN : (Date.parse(end) - nowMs) / DAY_MS;
  return {
    ...(isNew && !/^[A-Za-z0-9_.-]{1,64}$/.test(fields.name) ? { name: true as const } : {}),
    ...(isNew && !(age >= 14 && age <= 100) ? { age: true as const } : {}),
    ...(days > 0 && days <= MAX_CONSENT_DAYS + 1 ? {} : { ends: true as const }),
    ...(fields.givenBy.trim() === "" ? { givenBy: true as const } : {}),
  };
}


/** The points of a chart: the least, the mean and the most of each part of the time. */
export function pointsOf(history: readonly HistoryPoint[]): { t: number; mean: number; min: number; max: number; n: number }[] {
  return history.map(({ at, least, mean, most, values }) => ({ t: Date.parse(at) / 1000, mean, min: least, max: most, n: values }));
}

export interface PressureGrid {
  rows: number;
  columns: number;
  /** By row and column, 0 to 1 of the largest; null where no cell is, or where nothing was measured. */
  cells: readonly (number | null)[][];
  /** The centre in cells from the upper left corner; null without a load. */
  centre: { x: number; y: number } | null;
}

/** The cells of a pressure map by the names of its channels ("r0c2"); null if they have no place. */
export function pressureGrid(channels: readonly string[], values: readonly (number | null)[]): PressureGrid | null {
  const places = channels.map((name) => /^r(\d{1,3})c(\d{1,3})$/.exec(name));
  if (places.length === 0 || places.some((place) => place === null)) return null;
  const at = places.map((place) => [Number(place?.[1]), Number(place?.[2])] as const);
  const [rows, columns] = [Math.max(...at.map(([row]) => row)) + 1, Math.max(...at.map(([, column]) => column)) + 1];
  const cells: (number | null)[][] = Array.from({ length: rows }, () => Array.from({ length: columns }, () => null));
  const most = values.reduce<number>((max, value) => Math.max(max, value ?? 0), 0);
  let [sum, x, y] = [0, 0, 0];
  at.forEach(([row, column], index) => {
    const value = values[index] ?? null;
    const line = cells[row];
    if (line !== undefined) line[column] = value === null ? null : most === 0 ? 0 : Math.max(value, 0) / most;
    const load = Math.max(value ?? 0, 0);
    sum += load;
    x += load * (column + 0.5);
    y += load * (row + 0.5);
  });
  return { rows, columns, cells, centre: sum === 0 ? null : { x: x / sum, y: y / sum } };
}
