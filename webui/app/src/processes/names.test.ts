import { expect, test } from "vitest";
import { businessKey } from "./names";

test.each([
  ["mx1gwewc-g3rid7us", null],
  ["bin-picking by glove-1 after bin-picking-0123456789ab", null],
  [null, null],
  ["order 7", "order 7"],
  ["batch001-42", "batch001-42"],
  ["sorted by Anna after lunch on Monday", "sorted by Anna after lunch on Monday"],
])("%s: a key that a person gave is shown, one that a page made is not", (key, shown) => {
  expect(businessKey({ key })).toBe(shown);
});
