/**
* The station: screen size, viewing distance and the minimum text size that follows from them.
 *
* ISO 9241-303 requires a cap height of at least 16 minutes of arc. At `distanceM`, an angle `a` covers
* 2 * distance * tan(a / 2). On a screen of `diagonalIn` inches this length is converted to CSS pixels, whatever
* the resolution and scaling. From 2 m, 16' are 9.3 mm: 34 px of cap height on a 24-inch full HD screen.
 */
import { useSyncExternalStore } from "react";

export interface Station {
  diagonalIn: number;
  distanceM: number;
}

/** The cap height of Inter as a fraction of its font size. */
export const CAP_HEIGHT = 0.727;
export const MIN_READ_ARCMIN = 16;
export const DEFAULT_STATION: Station = { diagonalIn: 24, distanceM: 2 };
/** The default station of a phone. */
export const HAND_HELD: Station = { diagonalIn: 6.1, distanceM: 0.4 };
export const MAX_PHONE_PX = 600;
export const bounds = {
  diagonalIn: { min: 4, max: 120, step: 1 },
  distanceM: { min: 0.3, max: 10, step: 0.1 },
} as const;

const MM_PER_INCH = 25.4;
const STORAGE_KEY = "handover.station";
const listeners = new Set<() => void>();

export interface Screen {
  width: number;
  height: number;
}

/** Return the default station of a screen. */
export function defaultStation({ width, height }: Screen): Station {
  return Math.min(width, height) < MAX_PHONE_PX ? HAND_HELD : DEFAULT_STATION;
}

/** Return the number of CSS pixels of `arcmin` minutes of arc on `screen`. */
export function pxOf(arcmin: number, { diagonalIn, distanceM }: Station, { width, height }: Screen): number {
  const pxPerMm = Math.hypot(width, height) / (diagonalIn * MM_PER_INCH);
  const angle = (arcmin / 60) * (Math.PI / 180);
  return 2 * distanceM * 1000 * Math.tan(angle / 2) * pxPerMm;
}

/** Return the smallest font size, in CSS pixels, whose capitals are 16 minutes of arc high. */
export function minFontPx(station: Station, screen: Screen): number {
  return pxOf(MIN_READ_ARCMIN, station, screen) / CAP_HEIGHT;
}

function within(value: unknown, { min, max }: { min: number; max: number }): number | null {
  return typeof value === "number" && value >= min && value <= max ? value : null;
}

function storedStation(): Station | null {
  try {
    const written = JSON.parse(localStorage.getItem(STORAGE_KEY) ?? "null") as Partial<Station> | null;
    const diagonalIn = within(written?.diagonalIn, bounds.diagonalIn);
    const distanceM = within(written?.distanceM, bounds.distanceM);
    return diagonalIn === null || distanceM === null ? null : { diagonalIn, distanceM };
  } catch {
    return null;
  }
}

/** Store the station on this device; null restores the default of the screen. */
export function keepStation(station: Station | null): void {
  if (station === null) localStorage.removeItem(STORAGE_KEY);
  else localStorage.setItem(STORAGE_KEY, JSON.stringify(station));
  for (const listener of listeners) listener();
}

function subscribe(listener: () => void): () => void {
  listeners.add(listener);
  window.addEventListener("resize", listener);
  window.addEventListener("storage", listener);
  return () => {
    listeners.delete(listener);
    window.removeEventListener("resize", listener);
    window.removeEventListener("storage", listener);
  };
}

/** As text, so that an unchanged station is an equal value. */
function snapshot(): string {
  const { width, height } = window.screen;
  const { diagonalIn, distanceM } = storedStation() ?? defaultStation({ width, height });
  return [diagonalIn, distanceM, width, height].join(" ");
}

export function useStation(): { station: Station; minPx: number } {
  const [diagonalIn = 24, distanceM = 2, width = 0, height = 0] = useSyncExternalStore(subscribe, snapshot).split(" ").map(Number);
  const station = { diagonalIn, distanceM };
  return { station, minPx: minFontPx(station, { width, height }) };
}
