import { expect, test } from "vitest";
import type { CauseView, ElementTimes } from "~/api/generated/task-orchestrator";
import { heatMarks, heatOf, scaleOf, valueOf, type HeatWords } from "./heat";

function element(name: string, more: Partial<ElementTimes> = {}): ElementTimes {
  const none = { medianMs: null, p90Ms: null, meanMs: null, waitingMs: null, workingMs: null, pausedMs: null };
  return { element: name, name, waiting: 0, working: 0, paused: 0, completed: 0, failed: 0, cancelled: 0, ...none, ...more };
}

const words: HeatWords = {
  value: (value) => `${value} ms`,
  measured: (value) => `mean ${value}`,
  open: ({ waiting }) => `${waiting} waiting`,
  incidents: (count) => `${count} incidents`,
};

test("the least is the coolest and the most the hottest; one value alone is the hottest", () => {
  expect(heatOf(10, { least: 10, most: 110 })).toBe("heat1");
  expect(heatOf(60, { least: 10, most: 110 })).toBe("heat3");
  expect(heatOf(110, { least: 10, most: 110 })).toBe("heat5");
  expect(heatOf(7, { least: 7, most: 7 })).toBe("heat5");
});

test("an element without failures has no value, a duration of 0 ms is one", () => {
  expect(valueOf(element("scan"), "failed")).toBeNull();
  expect(valueOf(element("scan", { waitingMs: 0 }), "waitingMs")).toBe(0);
  expect(scaleOf([element("scan")], "meanMs")).toBeNull();
});

test("marks show heat, value, open tasks and incidents, those of a called process at the call", () => {
  const cause = { element: "call.grip", count: 3 } as CauseView;
  const marks = heatMarks([element("scan", { meanMs: 100, waiting: 2 }), element("pick", { meanMs: 900 })], [cause], "meanMs", words);
  expect(marks.get("scan")).toEqual({
    looks: ["heat1"],
    badges: [
      { kind: "token", text: "2", title: "2 waiting" },
      { kind: "duration", text: "100 ms", title: "mean 100 ms" },
    ],
  });
  expect(marks.get("pick")?.looks).toEqual(["heat5"]);
  expect(marks.get("call")?.badges).toEqual([{ kind: "incident", text: "3", title: "3 incidents" }]);
});
