import { expect, test } from "vitest";
import { at } from "~/testing/views";
import { beganToday, comparable, startOfDay, untilNowYesterday } from "./day";

const now = Date.parse(at(0)) + 7 * 3_600_000 + 123_456;
const counts = { running: 0, completed: 4, failed: 1, medianMs: 1000 };

test("a day begins at midnight where the reader is", () => {
  const midnight = new Date(startOfDay(now));
  expect([midnight.getHours(), midnight.getMinutes()]).toEqual([0, 0]);
  expect(midnight.getTime()).toBeLessThanOrEqual(now);
});

test("yesterday ends at this time of day, a few minutes before at most", () => {
  const { since, until } = untilNowYesterday(now);
  expect(since < until).toBe(true);
  expect(startOfDay(Date.parse(until))).toBe(since);
  const today = new Date(now);
  const minutes = (day: Date) => day.getHours() * 60 + day.getMinutes();
  expect(minutes(today) - minutes(new Date(until))).toBeLessThan(5);
  expect(minutes(new Date(until))).toBeLessThanOrEqual(minutes(today));
});

test("yesterday is compared only if the cell was there all the time, and something ended", () => {
  const asked = untilNowYesterday(now).since;
  expect(comparable({ ...counts, since: asked }, asked)?.completed).toBe(4);
  expect(comparable({ ...counts, since: at(0) }, asked)).toBeNull();
  expect(comparable({ ...counts, completed: 0, failed: 0, since: asked }, asked)).toBeNull();
  expect(comparable(null, asked)).toBeNull();
});

test("a cell that began today says when", () => {
  const midnight = startOfDay(now);
  expect(beganToday({ ...counts, since: midnight }, midnight)).toBeNull();
  const began = new Date(Date.parse(midnight) + 60_000).toISOString();
  expect(beganToday({ ...counts, since: began }, midnight)).toBe(began);
});
