import { describe, expect, it } from "vitest";
import { oneLine, stateOf, type RuleView } from "./rules";

const rule: RuleView = {
  name: "battery",
  section: "ros_to_ngsild",
  enabled: true,
  from: "/battery_state",
  to: "Device:{header.frame_id}",
  type: "sensor_msgs/msg/BatteryState",
  received: 0,
  receivedPerS: 0,
  forwarded: 0,
  forwardedPerS: 0,
  dropped: 0, droppedByCause: {}, conflated: 0, errors: 0,
  lastValue: null,
  lastError: null,
  lastErrorAt: null,
};

describe("stateOf", () => {
  it("is off when it is switched off, whatever else there is", () => {
    expect(stateOf({ ...rule, enabled: false, received: 7, publishers: 1 })).toBe("off");
  });

  it("is silent when nobody speaks on the topic it listens to", () => {
    expect(stateOf({ ...rule, publishers: 0, received: 7 })).toBe("silent");
  });

  it("waits until something has come, and works from then on", () => {
    expect(stateOf(rule)).toBe("waits");
    expect(stateOf({ ...rule, publishers: 1, received: 1 })).toBe("works");
  });
});

describe("a value in a line", () => {
  it("is shown as it is written", () => {
    expect(oneLine({ speed: 0.5, at: [1, 2] })).toBe('{"speed":0.5,"at":[1,2]}');
    expect(oneLine("Grüße")).toBe("Grüße");
    expect(oneLine(null)).toBe("");
    expect(oneLine(false)).toBe("false");
  });

  it("ends where it grows too long", () => {
    expect(oneLine("x".repeat(500), 10)).toBe(`${"x".repeat(9)}…`);
  });
});
