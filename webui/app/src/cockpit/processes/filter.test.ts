import { expect, test } from "vitest";
import { conditionsOf, listQuery, type ListFilter } from "./filter";

const SCOPE = { definition: "p", version: "", period: { sinceMs: 0, untilMs: 3_600_000 } };
const ANY: ListFilter = { state: "", search: "", variables: "", resource: "", time: "", element: "" };

test("only what is chosen is asked for", () => {
  expect(listQuery(ANY, SCOPE).toString()).toBe("definition=p");
  expect(listQuery({ ...ANY, state: "incident", element: "grip" }, SCOPE).toString()).toBe("definition=p&incident=true&element=grip");
  expect(listQuery({ ...ANY, state: "failed", search: " 77 " }, SCOPE).toString()).toBe("definition=p&status=failed&search=77");
  expect(listQuery({ ...ANY, time: "ended" }, SCOPE).get("endedUntil")).toBe("1970-01-01T01:00:00.000Z");
});

test("conditions are divided by semicolons, but not within quotation marks", () => {
  expect(conditionsOf("")).toEqual([]);
  expect(conditionsOf(' total>=100 ; name="a;b" ;')).toEqual(["total>=100", 'name="a;b"']);
  expect(listQuery({ ...ANY, variables: "a=1;b=2" }, SCOPE).getAll("variable")).toEqual(["a=1", "b=2"]);
});
