import { expect, test } from "vitest";
import { at, process, task } from "~/testing/views";
import { byPerformer, failedSince, waitingTasks } from "./waiting";

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
