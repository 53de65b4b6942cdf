import { expect, test } from "vitest";
import { plainValue, readable, sentence } from "./readable";

test.each([
  ["it waits for urn:ngsi-ld:Device:demo:glove-1", "It waits for glove-1"],
  ['{"status": "failed", "id": "urn:ngsi-ld:Task:demo:p-1"}', "Status failed, id p-1"],
  ["{unclosed", "{unclosed"],
  ["ur10-1: busy", "ur10-1: busy"],
  ["http://127.0.0.1:1026 does not respond", "http://127.0.0.1:1026 does not respond"],
])("%s is shown for people", (text, shown) => {
  expect(readable(text)).toBe(shown);
});

test("values have no braces", () => {
  expect(plainValue({ speed: 0.5, at: [1, 2], by: "urn:ngsi-ld:Person:demo:anna" })).toBe("speed 0.5, at 1, 2, by anna");
  expect(plainValue(null)).toBe("–");
});

test("sentences begin with a capital letter, names stay", () => {
  expect(sentence("es gibt kein BPMN")).toBe("Es gibt kein BPMN");
  expect(sentence("ähnlich")).toBe("Ähnlich");
  expect(sentence("glove-1 is away")).toBe("glove-1 is away");
  expect(sentence("")).toBe("");
});
