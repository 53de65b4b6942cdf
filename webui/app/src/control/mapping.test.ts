import { describe, expect, test } from "vitest";
import { atRest, GAMEPAD, isLike, isUsed, KEYBOARD, ofGamepad, ofKeys } from "./mapping";

const pad = (axes: number[], pressed: number[] = []) => ({
  axes,
  buttons: Array.from({ length: 17 }, (_, index) => ({ pressed: pressed.includes(index) })),
});

describe("a keyboard", () => {
  test("moves the tool by its keys, and opposite keys cancel", () => {
    const moved = ofKeys(new Set(["KeyW", "KeyF", "Space"]), KEYBOARD);
    expect(moved.axes).toMatchObject({ x: 1, y: 0, z: -1 });
    expect(moved.hold).toBe(true);
    expect(ofKeys(new Set(["KeyW", "KeyS"]), KEYBOARD).axes.x).toBe(0);
  });
});

describe("a gamepad", () => {
  test("is at rest in its dead zone and grows from 0 beyond it", () => {
    expect(isUsed(ofGamepad(pad([0.1, -0.1, 0.05, 0]), GAMEPAD))).toBe(false);
    expect(ofGamepad(pad([0, -1, 0, 0]), GAMEPAD).axes.x).toBe(1);
    expect(ofGamepad(pad([0, -0.56, 0, 0]), GAMEPAD).axes.x).toBeCloseTo(0.5);
    expect(ofGamepad(pad([0, 0, 0, 0], [5]), GAMEPAD).hold).toBe(true);
  });

  test("with fewer axes than the mapping names does not move", () => {
    expect(ofGamepad(pad([]), GAMEPAD)).toEqual(atRest());
  });
});

test("a stored mapping of another form is not used", () => {
  expect(isLike({ ...GAMEPAD, gamma: 0.4 }, GAMEPAD)).toBe(true);
  expect(isLike({ ...GAMEPAD, axes: { ...GAMEPAD.axes, rx: { axis: 4, sense: 1 }, z: null } }, GAMEPAD)).toBe(true);
  expect(isLike({ gamma: 1 }, GAMEPAD)).toBe(false);
  expect(isLike({ ...KEYBOARD, keys: { hold: 3 } }, KEYBOARD)).toBe(false);
  expect(isLike([], KEYBOARD)).toBe(false);
});
