/** Where a person may be while a session runs: on the seat, or within the area that was drawn for the headset. */
import { SEAT_M, type Vector } from "./frames";

export type Posture = "seated" | "standing";
export type Outside = "away" | "high" | "low";

/** A head within this distance of the seat is on it. */
const SEAT_RADIUS_M = 0.6;
const STANDING_RADIUS_M = 1.0;
/** Below it a person has fallen or taken the headset off; a seated person above the other one has stood up. */
const LOWEST_M: Record<Posture, number> = { seated: 0.6, standing: 0.9 };
const HIGHEST_M: Record<Posture, number> = { seated: 1.55, standing: 2.3 };
/** From the edge of the area of the headset. */
const MARGIN_M = 0.15;

/** What is wrong with where a head is in the scene; null if nothing. `area` is the drawn area around (x, z), if known. */
export function outside(head: Readonly<Vector>, posture: Posture, area: readonly Readonly<Vector>[] | null): Outside | null {
  if (head.y > HIGHEST_M[posture]) return "high";
  if (head.y < LOWEST_M[posture]) return "low";
  if (posture === "standing" && area !== null && area.length > 2) return marginTo(head, area) < MARGIN_M ? "away" : null;
  return Math.hypot(head.x - SEAT_M, head.z) > (posture === "seated" ? SEAT_RADIUS_M : STANDING_RADIUS_M) ? "away" : null;
}

/** The distance of a place from the edge of a polygon around it; negative outside. */
export function marginTo({ x, z }: Readonly<Vector>, area: readonly Readonly<Vector>[]): number {
  let isInside = false;
  let nearest = Infinity;
  for (const [index, to] of area.entries()) {
    const from = area[(index + area.length - 1) % area.length] ?? to;
    const [wayX, wayZ] = [to.x - from.x, to.z - from.z];
    if (to.z > z !== from.z > z && x < from.x + (wayX * (z - from.z)) / wayZ) isInside = !isInside;
    const squared = wayX * wayX + wayZ * wayZ;
    const share = squared === 0 ? 0 : Math.min(Math.max(((x - from.x) * wayX + (z - from.z) * wayZ) / squared, 0), 1);
    nearest = Math.min(nearest, Math.hypot(x - from.x - share * wayX, z - from.z - share * wayZ));
  }
  return isInside ? nearest : -nearest;
}
