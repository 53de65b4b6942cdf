import { expect, it } from "vitest";
import type { TasklistView } from "~/live/messages";
import { at, atMs, listedTask as task, process } from "~/testing/views";
import { isInView, isLater, listedTasks, markOf, matches, sorted, urgencyOf, VIEWS, type Identity, type Order } from "./list";

const anna: Identity = { name: "Anna", groups: ["Packing"] };

const viewsOf = (over: Partial<TasklistView>) => VIEWS.filter((view) => isInView(task(over), view, anna));

it("shows a person what is assigned, offered and free", () => {
  expect(viewsOf({})).toEqual(["all", "free"]);
  expect(viewsOf({ persons: ["urn:ngsi-ld:Person:demo:anna"] })).toEqual(["all", "mine"]);
  expect(viewsOf({ persons: ["anna", "ben"] })).toEqual(["all", "groups"]);
  expect(viewsOf({ persons: ["ben"] })).toEqual(["all"]);
  expect(viewsOf({ groups: ["packing"] })).toEqual(["all", "groups", "free"]);
  expect(viewsOf({ claimedBy: "Anna", isClaimable: true })).toEqual(["all", "mine"]);
  expect(viewsOf({ claimedBy: "Ben", persons: ["anna"] })).toEqual(["all"]);
  expect(viewsOf({ groups: ["packing"], declinedBy: ["Anna"] })).toEqual(["all"]);
  expect(viewsOf({ isClaimable: false })).toEqual(["all"]);
});

it("hides a Task until its follow-up date, but not from the person who has claimed it", () => {
  const later = { followUpDate: at(60) };
  expect(isLater(task(later), atMs(59), anna)).toBe(true);
  expect(isLater(task(later), atMs(61), anna)).toBe(false);
  expect(isLater(task({ ...later, claimedBy: "Anna" }), atMs(0), anna)).toBe(false);
  expect(isLater(task(), atMs(0), anna)).toBe(false);
});

it("orders by due date, priority, age and name", () => {
  const listed = listedTasks(
    [
      task({ id: "a-1", name: "b", since: at(2) }),
      task({ id: "b-1", name: "a", dueDate: at(20), since: at(1) }),
      task({ id: "c-1", name: "c", priority: 90, since: at(0) }),
      task({ id: "d-1", name: "d", dueDate: at(10), priority: 10, since: at(3) }),
    ],
    [],
  );
  const names = (order: Order) => sorted(listed, order).map((one) => one.task.name).join("");
  expect([names("due"), names("priority"), names("newest"), names("name")]).toEqual(["dacb", "cabd", "dbac", "abcd"]);
});

it("marks what is overdue and what is due soon", () => {
  expect(urgencyOf(at(0), atMs(1))).toBe("overdue");
  expect(urgencyOf(at(3600), atMs(0))).toBe("soon");
  expect(urgencyOf(at(86_400), atMs(0))).toBe("later");
});

it("finds by name, process and group, and knows the name of a process", () => {
  const [one] = listedTasks([task({ groups: ["Packing"] })], [process({ id: "p-1", name: "Weighing · order-7" })]);
  if (one === undefined) throw new Error("no Task");
  expect(one.processName).toBe("Weighing · order-7");
  expect(["WEI", "order-7", "pack", " ", "other"].map((find) => matches(one, find))).toEqual([true, true, true, true, false]);
  expect(markOf(one.task)).toBe("weigh-2");
});
