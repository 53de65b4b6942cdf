import { describe, expect, it } from "vitest";
import { fitting } from "./fitting";

describe("the links of a row", () => {
  const widths = [50, 60, 70, 80];

  it("are all shown while they fit", () => {
    expect(fitting(widths, 10, 40, 290, 0)).toEqual([0, 1, 2, 3]);
  });

  it("leave room for the menu of the others", () => {
    expect(fitting(widths, 10, 40, 289, -1)).toEqual([0, 1, 2]);
    expect(fitting(widths, 10, 40, 249, -1)).toEqual([0, 1]);
  });

  it("always contain the open page", () => {
    expect(fitting(widths, 10, 40, 200, 3)).toEqual([0, 3]);
    expect(fitting(widths, 10, 40, 20, 3)).toEqual([3]);
  });

  it("never exceed the room, but for the open page", () => {
    for (let room = 0; room < 300; room += 7) {
      for (const here of [-1, 0, 2]) {
        const shown = fitting(widths, 10, 40, room, here);
        const menu = shown.length < widths.length ? 40 : 0;
        const used = shown.reduce((sum, index) => sum + (widths[index] ?? 0) + 10, menu - (menu === 0 ? 10 : 0));
        if (shown.some((index) => index !== here)) expect(used).toBeLessThanOrEqual(room);
      }
    }
  });
});
