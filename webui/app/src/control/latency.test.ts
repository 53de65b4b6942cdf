import { expect, test } from "vitest";
import { DelayHistory, KEPT_S, RoundTrips, topOf } from "./latency";

test("the network is the round trip without the time in the service", () => {
  const trips = new RoundTrips();
  expect(trips.now()).toEqual({ networkMs: null, networkMaxMs: null });
  trips.send(1, 100);
  trips.send(2, 120);
  trips.receive(1, 30, 140);
  trips.receive(1, 50, 160);
  trips.receive(2, 10, 150);
  expect(trips.now()).toEqual({ networkMs: 20, networkMaxMs: 20 });
  trips.receive(99, 0, 500);
  expect(trips.now().networkMaxMs).toBe(20);
});

test("the course of the delay reaches back as far as the chart, and no further", () => {
  const delays = new DelayHistory();
  for (let at = 0; at <= 100_000; at += 50) delays.push(at, at % 70, at % 100 === 0 ? 5 : null);
  const [times, network, robot] = delays.columns(100_000);
  expect(times[0]).toBe(-KEPT_S);
  expect(times.at(-1)).toBe(0);
  expect(times.every((time, index) => index === 0 || time > (times[index - 1] ?? 0))).toBe(true);
  expect([network.length, robot.length]).toEqual([times.length, times.length]);
  expect(robot.slice(-2)).toEqual([null, 5]);
  expect(delays.columns(100_000 + KEPT_S * 1000 + 1)[0]).toEqual([]);
});

test("the top of the chart has room for the largest delay, and at most two and a half times as much", () => {
  for (let most = 1; most < 5000; most *= 1.07) {
    expect(topOf(most)).toBeGreaterThanOrEqual(most);
    expect(topOf(most)).toBeLessThanOrEqual(Math.max(40, 2.5 * most));
  }
  expect(topOf(null)).toBe(40);
});
