import { expect, test } from "vitest";
import { gatewayMapping, initialMapping, isMappings, NO_MAPPINGS } from "./inputDevices";

test("axes that are named for a direction move it", () => {
  const { axes } = initialMapping(["stickX", "hand_y", "lift", "wrist.rz"]);
  expect(axes).toEqual({ x: { axis: "stickX", sense: 1 }, y: { axis: "hand_y", sense: 1 }, rz: { axis: "wrist.rz", sense: 1 } });
});

test("the gateway gets speeds of a stick, and ways of a hand", () => {
  const mapping = { gamma: 1, kind: "rate" as const, axes: { x: { axis: "a", sense: -1 as const }, rx: { axis: "b", sense: 1 as const } } };
  expect(gatewayMapping(mapping, ["a", "b"])).toEqual({
    x: { axis: "a", scale: -0.25, kind: "rate", deadZone: 0.05 },
    rx: { axis: "b", scale: 1, kind: "rate", deadZone: 0.05 },
  });
  expect(gatewayMapping({ ...mapping, kind: "position" }, ["a"])?.x).toEqual({ axis: "a", scale: -1, kind: "position", deadZone: 0 });
});

test("a device that sends velocities has no mapping", () => {
  expect(gatewayMapping(initialMapping([]), [])).toBeNull();
});

test("what is stored is used only if it is a mapping", () => {
  const stored = { devices: { "stylus-1": initialMapping(["stickX"]) } };
  expect(isMappings(stored)).toBe(true);
  expect(isMappings(NO_MAPPINGS)).toBe(true);
  for (const bad of [null, {}, { devices: null }, { devices: { a: { gamma: 9, kind: "rate", axes: {} } } }, { devices: { a: { gamma: 1, kind: "rate", axes: { w: { axis: "a", sense: 1 } } } } }]) {
    expect(isMappings(bad), JSON.stringify(bad)).toBe(false);
  }
});
