import { describe, expect, it, test } from "vitest";
import { device, value } from "./device.fixture";
import { conditionOf, connectionOf, digits, outOfRange, spaced, valuesOf } from "./values";

test("sensors stand as registered, also before their first value, then the joints", () => {
  const shown = valuesOf(device({ values: { elbow: value(0.5), humidity: value(40) } }));
  expect(shown.map(({ name, latest }) => [name, latest?.value ?? null])).toEqual([["temperature", null], ["humidity", 40], ["elbow", 0.5]]);
});

describe("the condition of a device", () => {
  it.each([
    ["ok", device({ values: { temperature: value(20) } })],
    ["ok", device({ connected: false, values: { temperature: value(20) } })],
    ["ok", device({ sensors: [], values: {} })],
    ["fault", device({ state: "error", connected: false })],
    ["away", device({ connected: false, values: { temperature: value(20, true) } })],
    ["away", device({ connected: false })],
    ["stale", device()],
    ["stale", device({ values: { temperature: value(20), humidity: value(40, true) } })],
    ["outOfRange", device({ values: { temperature: value(61), humidity: value(40, true) } })],
    ["stale", device({ values: { temperature: value(61, true), humidity: value(40) } })],
  ])("is %s", (condition, given) => {
    expect(conditionOf(given)).toBe(condition);
  });
});

test("a device can connect with a token or a valid certificate", () => {
  const now = 1_767_225_600;
  const away = { connected: false };
  const bare = { connected: false, hasToken: false };
  expect(connectionOf(device(), null, now * 1000)).toBe("open");
  expect(connectionOf(device(away), null, now * 1000)).toBe("away");
  expect(connectionOf(device(away), now - 1, now * 1000)).toBe("away");
  expect(connectionOf(device(bare), now + 1, now * 1000)).toBe("away");
  expect(connectionOf(device(bare), now - 1, now * 1000)).toBe("expired");
  expect(connectionOf(device(bare), null, now * 1000)).toBe("noAccess");
});

test("a value is compared with the range of its sensor", () => {
  const shown = (temperature: number) => valuesOf(device({ values: { temperature: value(temperature) } }))[0];
  expect([-21, -20, 60, 61].map((at) => outOfRange(shown(at) as never))).toEqual(["below", null, null, "above"]);
});

test("numbers have four digits, and whole numbers all of theirs", () => {
  expect([21.456789, 0.012345, 123456.7, -0.5].map((one) => digits(one, "en"))).toEqual(["21.46", "0.01235", "123,457", "-0.5"]);
});

test("names of values are written as words", () => {
  expect(["externalForce", "gripper_width", "x", "CO2", "panda_joint1", "sensorLED"].map(spaced)).toEqual(["External force", "Gripper width", "X", "CO2", "Panda joint1", "Sensor LED"]);
});
