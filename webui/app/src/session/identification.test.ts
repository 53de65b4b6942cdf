/** What a scanner types at a station. */
import { expect, it } from "vitest";
import { methodOf } from "./identification";

it("knows the codes that accounts makes from the numbers of badges", () => {
  expect(methodOf(" hnd_badge_8VGQB3mPLBb2HDfbDCa\n")).toBe("qr");
  expect(methodOf("B-anna-1")).toBe("badge");
  expect(methodOf("badge_1")).toBe("badge");
});
