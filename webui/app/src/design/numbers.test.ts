import { expect, test } from "vitest";
import { valueInWords } from "~/cell/objects/value";
import { number, percent, typedNumber } from "./numbers";

test("numbers are grouped and have the decimal sign of the language, never a mix", () => {
  expect([number(1000, "de"), number(937.73, "de")]).toEqual(["1.000", "937,73"]);
  expect([number(1000, "en"), number(937.734, "en")]).toEqual(["1,000", "937.73"]);
  expect(number(1234.5, "fi").replace(/\s/g, " ")).toBe("1 234,5");
  expect(percent(0.452, "en")).toBe("45%");
});

test.each(["en", "de", "fi"])("a number that was typed is read as %s writes it, with separators or without", (language) => {
  for (const value of [0, 937.73, 1000, -1234.5, 1234567.25]) {
    expect(typedNumber(number(value, language), language)).toBe(value);
    expect(typedNumber(number(value, language, { useGrouping: false }), language)).toBe(value);
  }
  expect(["", "  ", "many", "1..2", "Infinity"].map((text) => typedNumber(text, language))).toEqual([null, null, null, null, null]);
});

test("the value of a device is written in the language too, lists without commas between", () => {
  expect(valueInWords(937.73, "de")).toBe("937,73");
  expect(valueInWords([1000, 937.73], "de")).toBe("1.000 · 937,73");
  expect(valueInWords({ x: 1.5, pose: { at: [1, 2] }, by: "urn:ngsi-ld:Device:demo:arm" }, "de")).toBe("x 1,5; pose at 1 · 2; by arm");
  expect(valueInWords("on", "de")).toBe("on");
  expect(valueInWords(null, "de")).toBeNull();
});
