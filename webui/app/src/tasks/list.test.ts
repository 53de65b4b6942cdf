import { expect, it } from "vitest";
import type { TasklistView } from "~/live/messages";
import { process, task as taskOf } from "~/testing/views";
import { isMine, listedTasks } from "./list";

function task(over: Partial<TasklistView> = {}): TasklistView {
  return {
    id: "urn:ngsi-ld:Task:demo:t-1", kind: "weigh", description: null, status: "pending", person: null,
    claimedBy: null, isClaimable: true, deadline: null, form: null, inputs: {}, ...over,
  };
}

it("has the earliest deadline first, and names from the drawing before the description", () => {
  const late = task({ id: "urn:ngsi-ld:Task:demo:t-2", description: "Pack it", deadline: "2026-03-02T09:00:00Z" });
  const soon = task({ deadline: "2026-03-02T08:00:00Z", description: "Weigh it" });
  const never = task({ id: "urn:ngsi-ld:Task:demo:t-3" });
  const owner = process({ tasks: [taskOf({ id: soon.id, name: "Weigh the part" })] });
  const listed = listedTasks([never, late, soon], [owner]);
  expect(listed.map(({ name }) => name)).toEqual(["Weigh the part", "Pack it", "weigh"]);
  expect(listed.map((one) => one.process)).toEqual([owner, null, null]);
});

it("is mine if I have claimed it, or if it is assigned to me and claimed by nobody", () => {
  const anna = "urn:ngsi-ld:Person:demo:anna";
  expect(isMine(task({ claimedBy: "Anna" }), "Anna")).toBe(true);
  expect(isMine(task({ person: anna }), "Anna")).toBe(true);
  expect(isMine(task({ person: anna, claimedBy: "Ben" }), "Anna")).toBe(false);
  expect(isMine(task(), "Anna")).toBe(false);
  expect(isMine(task({ person: anna }), "")).toBe(false);
});
