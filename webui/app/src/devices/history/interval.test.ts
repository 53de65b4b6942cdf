import { expect, test } from "vitest";
import { columnsOf, HORIZONS, intervalIn, intervalText, lastInterval, moved, summaryOf, withForecast, zoomed } from "./interval";

const point = (t: number, mean = t, n = 1) => ({ t, n, mean, min: mean - 1, max: mean + 1 });

test("an interval is written into the address and read again", () => {
  expect(intervalIn(intervalText({ begin: 1000.4, end: 2000 }))).toEqual({ begin: 1000, end: 2000 });
  expect(["", "5", "9-5", "a-b", "1-2-3", "0-5"].map(intervalIn)).toEqual([null, null, null, null, null, null]);
});

test("the last hour moves on in steps of five seconds", () => {
  expect(lastInterval("hour", 1_000_001)).toEqual(lastInterval("hour", 1_000_004));
  expect(lastInterval("hour", 1_000_001)).toEqual({ begin: 1_000_005 - 3600, end: 1_000_005 });
});

test("zooming keeps the middle, and ends at ten seconds", () => {
  expect(zoomed({ begin: 1000, end: 2000 }, 0.5)).toEqual({ begin: 1250, end: 1750 });
  expect(zoomed({ begin: 1000, end: 1012 }, 0.5)).toEqual({ begin: 1001, end: 1011 });
  expect(moved({ begin: 1000, end: 2000 }, -0.5)).toEqual({ begin: 500, end: 1500 });
  expect(moved({ begin: 100, end: 2000 }, -1)).toEqual({ begin: 1, end: 1901 });
});

test("the line is broken where values are missing, not where they are rare", () => {
  expect(columnsOf([point(0), point(10), point(20), point(90)], 5)[3]).toEqual([0, 10, 20, null, 90]);
  expect(columnsOf([point(0), point(60), point(120)], 1)[3]).toEqual([0, 60, 120]);
  expect(columnsOf([], 1)).toEqual([[], [], [], []]);
});

test("a forecast continues the line from the last value, and never goes back behind it", () => {
  const points = [9, 20, 30].map((t) => ({ t, mean: 5, low: 4, high: 6 }));
  const columns = withForecast(columnsOf([point(0), point(10, 7)], 5), points);
  expect(columns[0]).toEqual([0, 10, 20, 30]);
  expect(columns[3]).toEqual([0, 7, null, null]);
  expect(columns.slice(4)).toEqual([
    [null, 7, 4, 4],
    [null, 7, 6, 6],
    [null, 7, 5, 5],
  ]);
  expect(withForecast(columnsOf([point(0), point(10)], 5), []).slice(4)).toEqual(Array(3).fill([null, null]));
  expect(withForecast(columnsOf([], 5), points)[6]).toEqual([5, 5, 5]);
});

test("the steps of a forecast fit into a day, so that the day before can be compared", () => {
  for (const { seconds, steps } of Object.values(HORIZONS)) expect((86_400 * steps) % seconds).toBe(0);
});

test("the summary weighs intervals by their numbers of values", () => {
  expect(summaryOf([point(0, 10, 3), point(1, 20, 1)])).toEqual({ min: 9, mean: 12.5, max: 21 });
  expect(summaryOf([])).toBeNull();
});
