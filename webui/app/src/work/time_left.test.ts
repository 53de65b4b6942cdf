import { expect, it } from "vitest";
import { secondsLeft } from "./time_left";

const task = { createdAt: "2026-01-01T10:00:00Z" };
const at = (seconds: number) => Date.parse(task.createdAt) + 1000 * seconds;

it("takes the robot's own word first", () => {
  expect(secondsLeft({ remainingS: 3.2 }, task, { medianMs: 60_000 }, at(1))).toBe(4);
  expect(secondsLeft({ remainingS: 0 }, task, undefined, at(1))).toBe(1);
});

it("else goes by how long the step has taken before", () => {
  expect(secondsLeft(null, task, { medianMs: 5000 }, at(1))).toBe(4);
  expect(secondsLeft({ remainingS: null }, task, { medianMs: 5000 }, at(2))).toBe(3);
  expect(secondsLeft(null, task, { medianMs: 5000 }, at(-30))).toBe(5);
});

it("says nothing when nobody knows", () => {
  expect(secondsLeft(null, task, undefined, at(1))).toBeNull();
  expect(secondsLeft(null, task, { medianMs: null }, at(1))).toBeNull();
  expect(secondsLeft(null, task, { medianMs: 5000 }, at(9))).toBeNull();
});
