import { expect, it } from "vitest";
import type { OfferedChange } from "~/api/generated/task-orchestrator";
import { changeText } from "./changes";

const attribute: OfferedChange = { process: null, element: "gesture", name: null, change: "changed", before: "Horns", after: "Thumbs up" };
const text = (change: Partial<OfferedChange>) => changeText({ ...attribute, ...change }, (kind) => kind);

it("names the element of a process, and both values of an attribute", () => {
  expect(text({ process: "p", element: "pick", name: "Pick the part", change: "added", before: null, after: null })).toBe("Pick the part (added)");
  expect(text({ process: "p", element: "pick", change: "removed" })).toBe("pick (removed)");
  expect(text({})).toBe("gesture: Horns → Thumbs up");
  expect(text({ change: "added" })).toBe("gesture: Thumbs up");
  expect(text({ change: "removed" })).toBe("gesture: Horns (removed)");
});

it("shortens long values", () => {
  expect(text({ change: "added", after: { description: "x".repeat(500) } }).length).toBeLessThan(140);
});
