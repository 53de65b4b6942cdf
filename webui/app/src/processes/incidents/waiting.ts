/** What a process waits for beside its Tasks: performers that are busy, and resources that others have reserved. */
import { localizedText } from "~/i18n/server";
import type { ProcessView, ReservationView } from "~/api/generated/task-orchestrator";

/** What a page shows of a reservation: those that have ended are part of the export only. */
export function liveReservations(process: Pick<ProcessView, "reservations">): ReservationView[] {
  return process.reservations.filter(({ state, isShared }) => state !== "ended" && !isShared);
}

/** The elements that wait, each with its reasons; `drawnAt` returns the element of the drawing that shows it. */
export function waitingReasons(
  process: Pick<ProcessView, "reservations" | "unallocated">,
  drawnAt: (element: string) => string,
): ReadonlyMap<string, string> {
  const reasons = new Map<string, string>();
  const waiting = process.reservations.filter(({ state }) => state === "waiting");
  for (const each of [...process.unallocated, ...waiting]) {
    const element = drawnAt(each.element);
    const reason = localizedText(each, "reason") ?? "";
    const known = reasons.get(element);
    if (known === undefined) reasons.set(element, reason);
    else if (!known.includes(reason)) reasons.set(element, `${known}; ${reason}`);
  }
  return reasons;
}

/** The activities that wait for their performer, but for no reservation that is listed anyway. */
export function waitingActivities(process: Pick<ProcessView, "reservations" | "unallocated">): ProcessView["unallocated"] {
  const isReserving = process.reservations.some(({ state }) => state === "waiting");
  return process.unallocated.filter(({ reasonCode }) => !isReserving || reasonCode?.startsWith("reservation.") !== true);
}
