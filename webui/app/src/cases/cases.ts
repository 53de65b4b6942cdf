/** The machines of the case studies: what their page shows, and how. */
import type { HistoryView, MachineView, VitalView } from "~/api/generated/assistive-devices";
import type { StateView } from "~/api/generated/human-state";
import { number, percent } from "~/design/numbers";
import type { Tone } from "~/design/StatusBadge";

export const SERVICE = "assistive-devices";

/** Curves in one panel, since they have one unit. */
const TOGETHER: readonly (readonly string[])[] = [["speed", "vmax", "intent"], ["heartRate", "zoneLow", "zoneHigh"]];
const UNITS: Record<string, string> = { heartRate: "BPM", breathingRate: "C94", hrvRmssd: "C26", hrvSdnn: "C26", cadence: "C94", spo2: "P1", bodyMovement: "P1", skinTemperature: "CEL" };
const SYMBOLS: Record<string, string> = { MTS: "m/s", MTR: "m", "2A": "rad/s", SEC: "s", DD: "°", BPM: "bpm", C94: "/min", P1: "%" };
const CHART_UNITS: Record<string, string> = { speed: "MTS", vmax: "MTS", intent: "MTS", heartRate: "BPM", zoneLow: "BPM", period: "SEC", backrest: "DD", amplitude: "P1", fraction: "P1", robotFraction: "P1", effort: "P1", strain: "P1" };

export const pathOf = (machine: string) => `machines/${encodeURIComponent(machine)}`;

export interface Curve {
  name: string;
  points: readonly (readonly [number, number | null])[];
  last: number | null;
}

/** One panel for each unit: its curves, and the range of their values. */
export interface Panel {
  /** The UN/CEFACT code of its values, "" for none. */
  unit: string;
  curves: Curve[];
  low: number;
  high: number;
}

export function panelsOf({ atS, columns }: HistoryView): Panel[] {
  const groups = [...TOGETHER.map((names) => names.filter((name) => name in columns)).filter((names) => names.length > 0), ...Object.keys(columns).filter((name) => !TOGETHER.flat().includes(name)).map((name) => [name])];
  return groups.map((names) => {
    const curves = names.map((name) => {
      const points = atS.map((at, place) => [at, columns[name]?.[place] ?? null] as const);
      return { name, points, last: points.at(-1)?.[1] ?? null };
    });
    const values = curves.flatMap(({ points }) => points.map(([, value]) => value).filter((value) => value !== null));
    const low = Math.min(...values, names.includes("heartRate") ? Infinity : 0);
    const high = Math.max(...values, Number.isFinite(low) ? low + 0.1 : 1);
    return { unit: CHART_UNITS[names[0] ?? ""] ?? "", curves, low: Number.isFinite(low) ? low : 0, high };
  });
}

/** The path of a curve in a panel of `width` by `height`; a gap begins a new line. */
export function linePath({ points }: Curve, { low, high }: Panel, fromS: number, toS: number, width: number, height: number): string {
  let isDrawn = false;
  return points
    .map(([at, value]) => {
      if (value === null) {
        isDrawn = false;
        return "";
      }
      const x = ((at - fromS) / Math.max(toS - fromS, 1)) * width;
      const y = height - ((value - low) / Math.max(high - low, 1e-9)) * height;
      const step = `${isDrawn ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`;
      isDrawn = true;
      return step;
    })
    .join("");
}

/** The vital signs as the page Health shows them. */
export function stateOf({ person, vitals }: Pick<MachineView, "person" | "vitals">): StateView {
  return {
    person,
    pseudonym: "",
    exertion: null,
    strain: 0,
    isStrained: false,
    limit: null,
    values: vitals.filter(hasValue).map((vital) => ({ ...vital, unit: UNITS[vital.name] ?? null, status: vital.status as never, name: vital.name as never, method: "", disagree: false, sensors: [] })),
  };
}

function hasValue(vital: VitalView): vital is VitalView & { value: number | string } {
  return vital.value !== null;
}

export function limitTone({ fraction, needsReset }: MachineView["limit"]): Tone {
  return needsReset || fraction === 0 ? "stop" : fraction < 1 ? "attention" : "ok";
}

export function valueText(value: number, unit: string, language: string): string {
  const scale = unit === "BPM" ? 1 : 100;
  const rounded = Math.round(value * scale) / scale || 0; // no -0
  return unit === "P1" ? percent(value, language) : `${number(rounded, language)} ${SYMBOLS[unit] ?? unit}`.trim();
}
