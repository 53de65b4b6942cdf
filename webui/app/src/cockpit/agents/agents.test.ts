import { expect, test } from "vitest";
import type { AgentTask } from "~/api/generated/task-orchestrator";
import { isFound, loadOf, shiftsOf, standingOf } from "./agents";

const TASK = { id: "t" } as AgentTask;

test("an agent is unavailable before busy, and busy before off shift", () => {
  expect(standingOf({ unavailable: "error", isOnShift: true, tasks: [TASK] })).toBe("unavailable");
  expect(standingOf({ unavailable: null, isOnShift: false, tasks: [TASK] })).toBe("busy");
  expect(standingOf({ unavailable: null, isOnShift: false, tasks: [] })).toBe("offShift");
  expect(standingOf({ unavailable: null, isOnShift: true, tasks: [] })).toBe("idle");
});

test("the load is a share of the capacity", () => {
  expect(loadOf({ tasks: [TASK, TASK], capacity: 4 })).toBe(0.5);
  expect(loadOf({ tasks: [TASK], capacity: null })).toBe(1);
});

test("days in a row with the same times are one span", () => {
  const shift = (weekday: number, begins = "06:00") => ({ weekday, begins, ends: "14:00", zone: "UTC" });
  expect(shiftsOf({ shifts: [shift(1), shift(3), shift(2), shift(5), shift(6, "08:00")] }, "en-GB")).toBe("Mon–Wed, Fri 06:00–14:00; Sat 08:00–14:00");
  expect(shiftsOf({ shifts: [] }, "en")).toBe("");
  const whole = (weekday: number) => ({ weekday, begins: "00:00", ends: "00:00", zone: "UTC" });
  expect(shiftsOf({ shifts: [1, 2].map(whole) }, "en-GB")).toBe("Mon–Tue 00:00–24:00");
  expect(shiftsOf({ shifts: [1, 2, 3, 4, 5, 6, 7].map(whole) }, "en-GB")).toBe("");
});

test("agents are found by name, role and skill", () => {
  const agent = { id: "urn:ngsi-ld:Device:demo:ur10-1", roles: ["picker"], skills: { grip: { level: 1, cost: 0, speed: 1 } } };
  for (const text of ["UR10", "pick", "grip", ""]) expect(isFound(agent, text)).toBe(true);
  expect(isFound(agent, "demo")).toBe(false);
});
