import { describe, expect, it } from "vitest";
import { at, atMs, process, task } from "~/testing/views";
import { marksOf, percentAt, spanOf, stepFor } from "./axis";
import { courseOf } from "./course";
import { filtered, performersOf, statusesOf } from "./filter";
import { lanesOf } from "./lanes";
import { csvOf, fileName, jsonOf } from "./sheet";

const NOBODY = { text: "", statuses: [], performer: "" };

describe("the course of a Task", () => {
  const worked = task({
    status: "completed",
    endedAt: at(10),
    history: [
      { status: "pending", at: at(0) },
      { status: "assigned", at: at(2) },
      { status: "inProgress", at: at(3) },
      { status: "paused", at: at(5) },
      { status: "inProgress", at: at(8) },
      { status: "completed", at: at(10) },
    ],
  });

  it("distinguishes waiting from work, and counts pauses as neither", () => {
    const course = courseOf(worked, atMs(99));
    expect(course.waitedMs).toBe(3000);
    expect(course.workedMs).toBe(4000);
    expect(course.stretches.map((stretch) => stretch.status)).toEqual(["pending", "assigned", "inProgress", "paused", "inProgress"]);
    expect(course.toMs).toBe(atMs(10));
  });

  it("goes on until now while nobody has ended it", () => {
    const course = courseOf(task(), atMs(7));
    expect(course).toMatchObject({ ended: false, toMs: atMs(7), waitedMs: 7000, workedMs: 0 });
  });

  it("never runs backwards, whatever the clocks of the performers say", () => {
    const course = courseOf(
      task({
        status: "completed",
        endedAt: at(4),
        history: [{ status: "inProgress", at: at(-5) }, { status: "completed", at: at(60) }],
      }),
      atMs(99),
    );
    expect(course.stretches).toEqual([{ status: "inProgress", fromMs: atMs(0), toMs: atMs(4) }]);
  });

  it("shows a Task that has only just come", () => {
    expect(courseOf(task(), atMs(0)).stretches).toHaveLength(1);
  });
});

describe("the axis", () => {
  it("counts in steps that people count in", () => {
    expect(stepFor(60_000, 6)).toBe(10_000);
    expect(stepFor(3_600_000, 7)).toBe(600_000);
    expect(stepFor(86_400_000 * 365, 4)).toBeGreaterThanOrEqual((86_400_000 * 365) / 4);
  });

  it("marks round moments of local time, never more than asked for", () => {
    const span = { fromMs: atMs(3), toMs: atMs(63) };
    const marks = marksOf(span, 6, 0);
    expect(marks).toEqual([10, 20, 30, 40, 50, 60].map(atMs));
    // Half past the hour in a zone that lies half an hour off is no round moment of UTC.
    const hours = marksOf({ fromMs: atMs(0), toMs: atMs(4 * 3600) }, 4, -330);
    expect(hours[0]).toBe(atMs(1800));
  });

  it("keeps its end for a while as a process goes on, so that bars do not creep", () => {
    const ends = Array.from({ length: 600 }, (_none, second) => spanOf(atMs(0), atMs(second), true).toMs);
    expect(new Set(ends).size).toBeLessThan(15);
    ends.forEach((end, second) => expect(end).toBeGreaterThanOrEqual(atMs(second)));
  });

  it("holds what lies outside at its ends", () => {
    const span = { fromMs: 0, toMs: 100 };
    expect([-5, 0, 25, 100, 200].map((ms) => percentAt(span, ms))).toEqual([0, 0, 25, 100, 100]);
  });
});

it("puts the Tasks of a performer into one lane, those at the same time below each other", () => {
  const ended = (from: number, to: number, who: string) =>
    task({ id: `${who}-${from}`, createdAt: at(from), endedAt: at(to), status: "completed", involves: [`urn:ngsi-ld:Device:demo:${who}`] });
  const lanes = lanesOf([ended(6, 9, "robot"), ended(0, 5, "glove"), ended(2, 8, "glove"), ended(5, 9, "glove")], atMs(20));
  expect(lanes.map((lane) => [lane.performer, lane.rows])).toEqual([["glove", 2], ["robot", 1]]);
  expect(lanes[0]?.bars.map((bar) => bar.row)).toEqual([0, 1, 0]);
});

describe("the filter", () => {
  const tasks = [
    task(),
    task({ name: "Confirm the grip", element: "confirm_grip", status: "failed", reason: "the glove was lost", involves: ["urn:ngsi-ld:Device:demo:glove-1"] }),
  ];

  it("lets all pass when nothing is asked", () => {
    expect(filtered(tasks, NOBODY)).toEqual(tasks);
  });

  it("finds every word, in the reason as well", () => {
    expect(filtered(tasks, { ...NOBODY, text: " LOST grip " })).toEqual([tasks[1]]);
    expect(filtered(tasks, { ...NOBODY, text: "lost pick" })).toEqual([]);
  });

  it("goes by state and by performer", () => {
    expect(filtered(tasks, { ...NOBODY, statuses: ["failed", "paused"] })).toEqual([tasks[1]]);
    expect(filtered(tasks, { ...NOBODY, performer: "ur10-1" })).toEqual([tasks[0]]);
    expect(performersOf(tasks)).toEqual(["glove-1", "ur10-1"]);
  });

  it("reads states from a URL and names what is none", () => {
    expect(statusesOf("failed,pending")).toEqual(["pending", "failed"]);
    expect(() => statusesOf("failed,cancelled")).toThrow("status=cancelled");
  });
});

describe("the sheet", () => {
  const risky = task({ name: '=HYPERLINK("http://x")', status: "failed", endedAt: at(5), reason: "a, b\nand \"c\"" });

  it("quotes what a spreadsheet would misread, and runs nothing", () => {
    const csv = csvOf(process(), [risky], atMs(9));
    expect(csv.startsWith("\uFEFFprocess,task,")).toBe(true);
    expect(csv).toContain(`"'=HYPERLINK(""http://x"")"`);
    expect(csv).toContain('"a, b\nand ""c"""');
    expect(csv.endsWith("\r\n")).toBe(true);
    expect(csv).toContain(",5000,0,");
  });

  it("has every Task once, and the head alone when there is none", () => {
    expect(csvOf(process(), [], 0).trim().split("\r\n")).toHaveLength(1);
    const exported = JSON.parse(jsonOf(process({ tasks: [task(), risky] }), [risky])) as { id: string; tasks: unknown[] };
    expect(exported.id).toBe("bin-picking-1");
    expect(exported.tasks).toHaveLength(1);
  });

  it("has a name that every file system takes", () => {
    expect(fileName({ id: "a/b:c", definition: "x" }, "csv")).toBe("x-a_b_c-tasks.csv");
  });
});
