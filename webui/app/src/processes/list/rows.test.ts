import { describe, expect, it } from "vitest";
import { at, process } from "~/testing/views";
import { found, held, KEPT_ENDED, remembered, sameSections, together, type ProcessRow } from "./rows";

const running = (id: string, second: number): ProcessRow => process({ id, startedAt: at(second) });
const ended = (id: string, second: number): ProcessRow =>
  process({ id, startedAt: at(0), endedAt: at(second), status: "completed" });
const ids = (rows: readonly ProcessRow[]) => rows.map((row) => row.id);

it("puts new processes where they move none of those that run, and the latest end first", () => {
  const { running: now, ended: over } = together([running("b", 2), running("a", 1), ended("x", 5)], [ended("y", 9), running("a", 1)]);
  expect(ids(now)).toEqual(["a", "b"]);
  expect(ids(over)).toEqual(["y", "x"]);
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
    for (let nth = 0; nth < KEPT_ENDED + 50; nth++) history = remembered(history, [ended(`p${nth}`, nth)]);
    expect(history).toHaveLength(KEPT_ENDED);
    expect(history[0]?.id).toBe(`p${KEPT_ENDED + 49}`);
  });

  it("knows when a process that was retried has ended anew", () => {
    expect(remembered([ended("x", 3)], [ended("x", 8)])[0]?.endedAt).toBe(at(8));
  });
});

it("finds by title, id, key and the word for the state", () => {
  const rows = [process({ id: "one", key: "order 66" }), process({ id: "two", status: "failed" })];
  const said = (status: string) => (status === "failed" ? "gescheitert" : "in Arbeit");
  expect(ids(found(rows, "bin 66", said))).toEqual(["one"]);
  expect(ids(found(rows, "gescheitert", said))).toEqual(["two"]);
  expect(ids(found(rows, "", said))).toEqual(["one", "two"]);
});
