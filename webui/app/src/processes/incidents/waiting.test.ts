import { describe, expect, it } from "vitest";
import type { ProcessView } from "~/api/generated/task-orchestrator";
import { liveReservations, waitingActivities, waitingReasons } from "./waiting";

type Waits = Pick<ProcessView, "reservations" | "unallocated">;

const reservation: ProcessView["reservations"][number] = {
  key: "1.cell",
  element: "cell",
  name: "Cell",
  state: "waiting",
  since: "2026-05-04T08:00:00Z",
  askedAt: "2026-05-04T08:00:00Z",
  heldAt: null,
  agents: [],
  uses: [],
  isShared: false,
  reason: "ur10-1 is held by p-1",
};
const activity: ProcessView["unallocated"][number] = {
  token: "3",
  element: "pick",
  name: "Pick",
  reason: "ur10-1 is held by p-1",
  reasonCode: "reservation.held",
  since: "2026-05-04T08:00:00Z",
};

describe("what a process waits for", () => {
  it("shows reservations that have not ended and are its own", () => {
    const ended = { ...reservation, state: "ended" as const };
    const shared = { ...reservation, state: "held" as const, isShared: true };
    expect(liveReservations({ reservations: [ended, shared, reservation] })).toEqual([reservation]);
  });

  it("lists an activity that waits for a reservation once, as the reservation", () => {
    const busy = { ...activity, token: "4", reason: "b is busy", reasonCode: "allocation.busy" };
    expect(waitingActivities({ reservations: [reservation], unallocated: [activity, busy] })).toEqual([busy]);
    expect(waitingActivities({ reservations: [], unallocated: [activity] })).toEqual([activity]);
  });

  it("gives each element its reasons once", () => {
    const busy = { ...activity, reason: "b is busy", reasonCode: "allocation.busy" };
    const process: Waits = { reservations: [reservation], unallocated: [activity, activity, busy] };
    const reasons = waitingReasons(process, (element) => element);
    expect([...reasons]).toEqual([
      ["pick", "ur10-1 is held by p-1; b is busy"],
      ["cell", "ur10-1 is held by p-1"],
    ]);
  });
});
