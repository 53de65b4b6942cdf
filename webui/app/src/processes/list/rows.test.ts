import { describe, expect, it } from "vitest";
import { at, incident, process, task } from "~/testing/views";
import { activityOf, found, held, MAX_ENDED, passes, remembered, sameSections, together, type ProcessRow, type ProcessSorting } from "./rows";

const running = (id: string, second: number): ProcessRow => process({ id, startedAt: at(second) });
const ended = (id: string, second: number): ProcessRow =>
  process({ id, startedAt: at(0), endedAt: at(second), status: "completed" });
const ids = (rows: readonly ProcessRow[]) => rows.map((row) => row.id);

it("has the newest first, of those that run and of those that have ended", () => {
  const { running: now, ended: over } = together([running("b", 2), running("a", 1), ended("x", 5)], [ended("y", 9), running("a", 1)]);
  expect(ids(now)).toEqual(["b", "a"]);
  expect(ids(over)).toEqual(["y", "x"]);
});

it("is sorted by age, name and key when asked; processes without a key come last", () => {
  const rows = [
    process({ id: "a", name: "Sort", key: "order 10", startedAt: at(1) }),
    process({ id: "b", name: "Clean", key: null, startedAt: at(2) }),
    process({ id: "c", name: "Pick", key: "order 9", startedAt: at(3) }),
  ];
  const sorted = (by: ProcessSorting) => ids(together(rows, [], by).running).join("");
  expect([sorted("newest"), sorted("oldest"), sorted("name"), sorted("key")]).toEqual(["cba", "abc", "bca", "cab"]);
});

it("passes by state, definition, version and person", () => {
  const row = process({ version: 2, tasks: [task({ involves: ["urn:ngsi-ld:Person:demo:ann"], endedAt: at(1) }), task({ name: "Pick the part" })] });
  const any = { status: "", definition: "", involves: "" };
  expect(passes(row, { ...any, definition: "bin-picking@2", involves: "urn:ngsi-ld:Person:demo:ann" })).toBe(true);
  expect(passes(row, { ...any, definition: "bin-picking@1" })).toBe(false);
  expect(passes(row, { ...any, definition: "bin" })).toBe(false);
  expect(passes(row, { ...any, involves: "urn:ngsi-ld:Person:demo:bob" })).toBe(false);
  expect(passes(row, { ...any, status: "failed" })).toBe(false);
  const stopped = process({ incidents: [incident()] });
  expect([row, stopped].map((one) => passes(one, { ...any, status: "incident" }))).toEqual([false, true]);
  expect(passes(stopped, { ...any, status: "inProgress" })).toBe(true);
  expect(passes({ ...stopped, status: "failed" }, { ...any, status: "incident" })).toBe(false);
  expect(activityOf(row)).toBe("Pick the part");
});

it("believes the live view where the history is older", () => {
  const { running: now, ended: over } = together([running("a", 1)], [ended("a", 5)]);
  expect([ids(now), ids(over)]).toEqual([["a"], []]);
});

describe("a list that somebody is in", () => {
  const shown = { running: [running("a", 1), running("b", 2)], ended: [ended("x", 3)] };

  it("keeps its places and counts what waits", () => {
    const now = { running: [running("b", 2), running("c", 4)], ended: [ended("a", 6), ended("x", 3)] };
    const { sections, waiting } = held(shown, now);
    expect(ids(sections.running)).toEqual(["a", "b"]);
    expect(sections.running[0]?.status).toBe("completed");
    expect(waiting).toBe(2);
  });

  it("has nothing waiting while nothing changes", () => {
    expect(held(shown, shown).waiting).toBe(0);
    expect(sameSections(held(shown, shown).sections, shown)).toBe(true);
  });
});

describe("the history", () => {
  it("stays the same while nothing ends", () => {
    const history = [ended("x", 3)];
    expect(remembered(history, [running("a", 1), ended("x", 3)])).toBe(history);
  });

  it("remembers what has left the live view, and not without bound", () => {
    let history: readonly ProcessRow[] = [];
    for (let nth = 0; nth < MAX_ENDED + 50; nth++) history = remembered(history, [ended(`p${nth}`, nth)]);
    expect(history).toHaveLength(MAX_ENDED);
    expect(history[0]?.id).toBe(`p${MAX_ENDED + 49}`);
  });

  it("recognizes that a retried process has ended again", () => {
    expect(remembered([ended("x", 3)], [ended("x", 8)])[0]?.endedAt).toBe(at(8));
  });
});

it("finds by title, id, key and the word for the state", () => {
  const rows = [process({ id: "one", key: "order 66" }), process({ id: "two", status: "failed" })];
  const said = (status: string) => (status === "failed" ? "gescheitert" : "in Arbeit");
  expect(ids(found(rows, "bin 66", said))).toEqual(["one"]);
  expect(ids(found(rows, "gescheitert", said))).toEqual(["two"]);
  expect(ids(found(rows, "two", said))).toEqual([]);
  expect(ids(found([process({ id: "bin-picking-4f3a9c" })], "ing-4f3a9", said))).toHaveLength(1);
  expect(ids(found(rows, "", said))).toEqual(["one", "two"]);
});
