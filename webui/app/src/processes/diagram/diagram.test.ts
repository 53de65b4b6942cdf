// @vitest-environment jsdom
import { readFileSync } from "node:fs";
import { describe, expect, it } from "vitest";
import type { ElementCounts, TokenState } from "~/api/generated/task-orchestrator";
import { incident } from "~/testing/views";
import { drawn, hasDrawing, withFlowsNamed } from "./layout";
import { difference, marksOfFaults, marksOfProcess, marksOfStatistics, NO_MARKS, withPicked, withTargets, type MarkWords } from "./marks";

const words: MarkWords = {
  token: (count) => `${count} here`,
  failed: (count) => `${count} failed`,
  incident: (count) => `${count} incidents`,
  count: (count) => ({ text: String(count), title: `${count} done` }),
  duration: (last, median) => ({ text: `${last ?? 0} ms`, title: `median ${median ?? 0}` }),
};

const count = (over: Partial<ElementCounts>): ElementCounts => ({ running: 0, completed: 0, failed: 0, lastMs: null, medianMs: null, ...over });

describe("the marks of a process", () => {
  const marks = marksOfProcess(
    {
      waiting: ["pick", "wait", "wait"],
      elements: {
        pick: count({ running: 1, completed: 2, lastMs: 1500, medianMs: 1200 }),
        scan: count({ failed: 1 }),
        home: count({ completed: 1, failed: 1, lastMs: 10 }),
        free: count({}),
      },
    },
    words,
  );

  it("show where its tokens are, also where no Task is", () => {
    expect(marks.get("pick")?.looks).toEqual(["token"]);
    expect(marks.get("wait")?.badges).toEqual([{ kind: "token", text: "2", title: "2 here" }]);
  });

  it("count the tokens at an element that is listed once, without the token of a loop", () => {
    const token = (id: string, element: string, state: TokenState) => ({ token: id, element, name: "", state, instance: "", task: null });
    const tokens = [token("1", "pick", "loop"), token("2", "pick", "work"), token("3", "pick", "work"), token("4", "wait", "waiting")];
    const shown = marksOfProcess({ waiting: ["pick", "wait", "timer"], elements: {}, tokens }, words);
    expect(["pick", "wait", "timer"].map((element) => shown.get(element)?.badges[0]?.text)).toEqual(["2", "", ""]);
  });

  it("count and time what was done", () => {
    expect(marks.get("pick")?.badges.map((badge) => badge.kind)).toEqual(["token", "count", "duration"]);
  });

  it("say of an activity that it failed only while it has not been done since", () => {
    expect(marks.get("scan")?.looks).toEqual(["failed"]);
    expect(marks.get("home")?.looks).toEqual(["done"]);
    expect(marks.get("home")?.badges[0]?.kind).toBe("failed");
  });

  it("show incidents before tokens, those of a called process at the call", () => {
    const shown = marksOfProcess(
      {
        waiting: ["pick", "pack", "pack.wrap"],
        elements: { pick: count({ failed: 1 }) },
        incidents: [incident({ element: "pick" }), incident({ token: "8", element: "pack.wrap" }), incident({ token: "9", element: "pack.fold" })],
      },
      words,
      (element) => element.split(".")[0] ?? element,
    );
    expect([...shown.keys()].sort()).toEqual(["pack", "pick"]);
    expect(shown.get("pick")?.looks).toEqual(["incident"]);
    expect(shown.get("pick")?.badges.map(({ kind, text }) => [kind, text])).toEqual([["incident", ""], ["failed", "1"]]);
    expect(shown.get("pack")?.badges).toEqual([{ kind: "incident", text: "2", title: "2 incidents" }]);
  });

  it("leave alone what has not been reached", () => {
    expect(marks.has("free")).toBe(false);
  });
});

it("statistics count, but have no one state", () => {
  const marks = marksOfStatistics({ pick: count({ running: 3, completed: 40, medianMs: 900 }) }, words);
  expect(marks.get("pick")).toMatchObject({ looks: [], badges: [{ kind: "token", text: "3" }, { kind: "count" }, { kind: "duration" }] });
});

it("every fault of an element stands there with its number in the list", () => {
  const marks = marksOfFaults([
    { element: null, message: "no start" },
    { element: "scan", message: "a" },
    { element: "scan", message: "b" },
  ]);
  expect([...marks.keys()]).toEqual(["scan"]);
  expect(marks.get("scan")?.badges.map((badge) => badge.text)).toEqual(["2", "3"]);
});

describe("the difference between marks", () => {
  const first = marksOfProcess({ waiting: ["pick"], elements: { pick: count({ running: 1 }) } }, words);

  it("is empty when a process is unchanged", () => {
    const again = marksOfProcess({ waiting: ["pick"], elements: { pick: count({ running: 1 }) } }, words);
    expect(difference(first, again)).toEqual({ lose: [], gain: [], badges: [] });
  });

  it("touches only what has changed", () => {
    const next = marksOfProcess(
      { waiting: ["place"], elements: { pick: count({ completed: 1, lastMs: 5 }), place: count({ running: 1 }) } },
      words,
    );
    const change = difference(first, next);
    expect(change.lose).toEqual([{ element: "pick", look: "token" }]);
    expect(change.gain).toEqual([{ element: "pick", look: "done" }, { element: "place", look: "token" }]);
    expect(change.badges.map((one) => one.element)).toEqual(["pick", "place"]);
  });

  it("takes all away in the end", () => {
    expect(difference(first, NO_MARKS)).toMatchObject({ lose: [{ element: "pick", look: "token" }], badges: [{ element: "pick", badges: [] }] });
  });

  it("picks an element without touching its badges", () => {
    expect(difference(first, withPicked(first, "pick"))).toEqual({ lose: [], gain: [{ element: "pick", look: "picked" }], badges: [] });
  });
});

describe("a file without a drawing", () => {
  const shipped = readFileSync("../../services/task_orchestrator/handover_processes/processes/bin_picking.bpmn", "utf-8");
  const bare = shipped.replace(/<bpmndi:BPMNDiagram[\s\S]*<\/bpmndi:BPMNDiagram>/, "");

  it("is distinguished from one with a layout, which is kept", async () => {
    expect(hasDrawing(shipped)).toBe(true);
    expect(hasDrawing(bare)).toBe(false);
    expect(await drawn(shipped)).toEqual({ xml: shipped, laidOut: false });
  });

  it("gets one with every activity in it", async () => {
    const { xml, laidOut } = await drawn(bare);
    expect(laidOut).toBe(true);
    const places = new DOMParser().parseFromString(xml, "application/xml").getElementsByTagName("bpmndi:BPMNShape");
    const shown = [...places].map((shape) => shape.getAttribute("bpmnElement"));
    expect(shown).toEqual(expect.arrayContaining(["confirm_clear", "scan", "pick", "place", "pick_failed"]));
  });
});

describe("a file without incoming and outgoing", () => {
  const shipped = readFileSync("../../services/task_orchestrator/handover_processes/processes/bin_picking.bpmn", "utf8");
  const bare = shipped
    .replace(/<bpmndi:BPMNDiagram[\s\S]*<\/bpmndi:BPMNDiagram>/, "")
    .replace(/<(?:bpmn:)?(incoming|outgoing)>[^<]*<\/(?:bpmn:)?\1>/g, "");

  it("is laid out with all its arrows", async () => {
    expect(bare).not.toMatch(/<(?:bpmn:)?incoming>/);
    const { xml, laidOut } = await drawn(bare);
    expect(laidOut).toBe(true);
    const flows = bare.match(/<(?:bpmn:)?sequenceFlow /g) ?? [];
    expect(flows.length).toBeGreaterThan(5);
    expect(xml.match(/<bpmndi:BPMNEdge /g) ?? []).toHaveLength(flows.length);
  });

  it("is left alone where it names its flows", () => {
    const named = withFlowsNamed(bare);
    expect(named).not.toBe(bare);
    expect(withFlowsNamed(named)).toBe(named);
  });
});

it("targets of a token keep the marks that they have", () => {
  const shown = withTargets(marksOfProcess({ waiting: ["pick"], elements: {} }, words), ["pick", "place"]);
  expect(shown.get("pick")?.looks).toEqual(["token", "target"]);
  expect(shown.get("place")).toEqual({ looks: ["target"], badges: [] });
});

it("warnings are numbered after the faults, and mark no element as faulty", () => {
  const marks = marksOfFaults([{ element: "scan", message: "a" }], [{ element: "store", message: "b" }, { element: "scan", message: "c" }]);
  expect(marks.get("store")).toEqual({ looks: [], badges: [{ kind: "warning", text: "2", title: "b" }] });
  expect(marks.get("scan")).toMatchObject({ looks: ["fault"], badges: [{ text: "1" }, { kind: "warning", text: "3" }] });
});
