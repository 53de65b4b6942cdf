import { expect, test } from "vitest";
import type { TasklistView } from "~/live/messages";
import { at, atMs, process, task } from "~/testing/views";
import { byPerformer, failedSince, runningProcesses, tasksFor, waitingTasks } from "./waiting";

const asked = (id: string, who: string, second: number) =>
  task({ id, involves: [`urn:ngsi-ld:Device:demo:${who}`], createdAt: at(0), history: [{ status: "pending", at: at(second) }] });

test("open tasks stand by how long they have waited, and for whom", () => {
  const waiting = waitingTasks([
    process({ id: "a", tasks: [asked("late", "glove-1", 9), task({ id: "done", endedAt: at(1) })] }),
    process({ id: "b", tasks: [asked("early", "ur10-1", 3), asked("middle", "glove-1", 5), task({ id: "called back", cancelled: true })] }),
    process({ id: "c", endedAt: at(9), tasks: [asked("of an ended process", "glove-2", 1)] }),
  ]);
  expect(waiting.map((each) => each.task.id)).toEqual(["early", "middle", "late"]);
  expect(waiting[1]?.since).toBe(at(5));
  expect(byPerformer(waiting)).toEqual([
    { who: "glove-1", count: 2, since: at(5) },
    { who: "ur10-1", count: 1, since: at(3) },
  ]);
});

test("failed processes of the day, the newest first", () => {
  const failed = (id: string, second: number) => process({ id, status: "failed", endedAt: at(second) });
  expect(failedSince([failed("a", 5), failed("b", 9), failed("old", 1), process({ id: "runs" })], at(2)).map((each) => each.id)).toEqual(["b", "a"]);
});

const listed = (id: string, over: Partial<TasklistView> = {}): TasklistView => ({
  id: `urn:ngsi-ld:Task:demo:${id}`,
  name: id,
  description: null,
  process: "p",
  element: "e",
  status: "pending",
  persons: [],
  groups: [],
  claimedBy: null,
  declinedBy: [],
  isClaimable: true,
  since: at(0),
  deadline: null,
  dueDate: null,
  followUpDate: null,
  priority: null,
  ...over,
});

test("what waits for a person: claimed, personal and of the person's groups; what is free is apart, what others do is not there", () => {
  const tasks = [
    listed("claimed", { claimedBy: "Anna", since: at(9) }),
    listed("personal", { persons: ["urn:ngsi-ld:Person:demo:Anna"], since: at(1) }),
    listed("group", { groups: ["packing"], since: at(5) }),
    listed("declined", { groups: ["packing"], declinedBy: ["Anna"] }),
    listed("of others", { groups: ["packing"], claimedBy: "Bert" }),
    listed("other group", { groups: ["quality"] }),
    listed("free", { since: at(2) }),
    listed("later", { followUpDate: at(100) }),
    listed("by a robot", { isClaimable: false }),
  ];
  const { own, free } = tasksFor(tasks, { name: "Anna", groups: ["packing"] }, atMs(10));
  expect(own.map(({ name }) => name)).toEqual(["personal", "group", "claimed"]);
  expect(free.map(({ name }) => name)).toEqual(["free"]);
});

test("without groups, Tasks of all groups are free, so that somebody without a name finds work", () => {
  const { own, free } = tasksFor([listed("group", { groups: ["packing"] })], { name: "", groups: [] }, atMs(10));
  expect([own.length, free.length]).toEqual([0, 1]);
});

test("lists have the oldest first: what comes later is below", () => {
  const running = [process({ id: "b", startedAt: at(5) }), process({ id: "a", startedAt: at(5) }), process({ id: "first", startedAt: at(1) }), process({ id: "ended", endedAt: at(9) })];
  expect(runningProcesses(running).map(({ id }) => id)).toEqual(["first", "a", "b"]);
});
