import { expect, test } from "vitest";
import { device, value } from "~/devices/device.fixture";
import { linesOf, matching, roomOf } from "./rooms";

const inRoom = (name: string, location: string | null) => device({ name, location });

test("rooms stand by name with their devices in rows, devices without a room last", () => {
  const lines = linesOf([inRoom("d", null), inRoom("s-10", "urn:ngsi-ld:Location:demo:hall"), inRoom("s-9", "hall"), inRoom("s-1", "hall"), inRoom("k", "cell 2")], 2);
  expect(lines.map((line) => (line.kind === "room" ? `${line.room} ${line.count}` : line.devices.map((one) => one.name)))).toEqual([
    "cell 2 1", ["k"], "hall 3", ["s-1", "s-9"], ["s-10"], "null 1", ["d"],
  ]);
  expect(roomOf(inRoom("a", ""))).toBeNull();
});

test("devices are found by name, room and sensor, and by what is wrong with them", () => {
  const all = [device({ name: "a", location: "hall", values: { temperature: value(20) } }), device({ name: "b", location: "hall", connected: false })];
  const found = (find: string, needsAttention = false) => matching(all, find, needsAttention).map((one) => one.name);
  expect([found(""), found("HALL b"), found("humid"), found("", true)]).toEqual([["a", "b"], ["b"], ["a", "b"], ["b"]]);
});
