import { expect, test } from "vitest";
import { RoundTrips } from "./latency";

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
