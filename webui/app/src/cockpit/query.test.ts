import { expect, test } from "vitest";
import { periodOf, pointsOf, statisticsQuery, stepsOf } from "./query";

const HOUR = 3_600_000;
const NOW = Date.parse("2026-05-04T08:30:00Z");

test("a period that ends now has whole hours and no end", () => {
  const { sinceMs, untilMs } = periodOf("day", "", "", NOW);
  expect(new Date(sinceMs).toISOString()).toBe("2026-05-03T09:00:00.000Z");
  expect(untilMs).toBeNull();
  expect(periodOf("day", "", "", NOW + 20 * 60_000).sinceMs).toBe(sinceMs);
});

test("chosen days begin and end at midnight of the reader; a day in the future ends now", () => {
  const { sinceMs, untilMs } = periodOf("custom", "2026-04-01", "2026-04-02", NOW);
  expect(sinceMs).toBe(new Date(2026, 3, 1).getTime());
  expect(untilMs).toBe(new Date(2026, 3, 3).getTime());
  expect(periodOf("custom", "2026-04-01", "2030-01-01", NOW).untilMs).toBeNull();
  expect(periodOf("custom", "soon", "", NOW).sinceMs).toBe(periodOf("week", "", "", NOW).sinceMs);
});

test("the query has only what is chosen", () => {
  const period = { sinceMs: 0, untilMs: null };
  expect(statisticsQuery({ definition: "", version: "", period })).toBe("since=1970-01-01T00%3A00%3A00.000Z");
  expect(statisticsQuery({ definition: "p", version: "2", period: { sinceMs: 0, untilMs: HOUR } }, { step: "hour" })).toContain("step=hour&definition=p&version=2");
});

test("long periods are asked for by day", () => {
  const of = (days: number) => stepsOf({ sinceMs: NOW - days * 24 * HOUR, untilMs: null }, NOW);
  expect(of(1)).toEqual({ shown: "hour", asked: "hour" });
  expect(of(30)).toEqual({ shown: "day", asked: "hour" });
  expect(of(365)).toEqual({ shown: "day", asked: "day" });
});

test("hours add up to days of the reader", () => {
  const start = new Date(2026, 4, 1).getTime();
  const given = Array.from({ length: 48 }, (_none, hour) => ({ at: new Date(start + hour * HOUR).toISOString(), started: 2, completed: 1, failed: hour === 30 ? 1 : 0 }));
  expect(pointsOf(given, "day")).toEqual({ at: [start / 1000, start / 1000 + 24 * 3600], started: [48, 48], completed: [24, 24], failed: [0, 1] });
  expect(pointsOf(given, "hour").at).toHaveLength(48);
});
