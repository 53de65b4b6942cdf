import { describe, expect, test } from "vitest";
import type { LiveEvent } from "~/live/messages";
import { allEvents, csv, gathered, held, passes, sourcesOf } from "./event_log";

function event(seq: number, rest: Partial<LiveEvent> = {}): LiveEvent {
  return {
    seq, at: "2026-01-01T08:00:00Z", level: "info", source: "glove-1", key: "device.state", values: {},
    text: `event ${seq}`, ...rest,
  };
}

const all = { level: "", source: "", text: "" } as const;
const seqs = (events: readonly LiveEvent[]) => events.map((one) => one.seq);

describe("gathering", () => {
  test("joins older and newer events, each once, in their order", () => {
    expect(seqs(gathered([event(4), event(5)], [event(2), event(4), event(6)]))).toEqual([2, 4, 5, 6]);
  });

  test("keeps only the newest", () => {
    expect(seqs(gathered([event(1), event(2)], [event(3), event(4)], 3))).toEqual([2, 3, 4]);
  });

  test("leaves the list as it is when nothing is new", () => {
    const known = [event(1), event(2)];
    expect(gathered(known, [event(2)])).toBe(known);
    expect(gathered(known, [])).toBe(known);
  });

  test("leaves no gap when the link forgets what the reader still has", () => {
    const early = gathered([], [event(1), event(2), event(3)]);
    expect(seqs(gathered(early, [event(3), event(4)]))).toEqual([1, 2, 3, 4]);
  });
});

describe("filtering", () => {
  test("by level takes what is at least as grave", () => {
    const levels = (["info", "attention", "stop"] as const).map((level, seq) => event(seq, { level }));
    const passing = (level: "" | "attention" | "stop") =>
      levels.filter((one) => passes(one, { ...all, level }, "")).map((one) => one.level);
    expect(passing("")).toEqual(["info", "attention", "stop"]);
    expect(passing("attention")).toEqual(["attention", "stop"]);
    expect(passing("stop")).toEqual(["stop"]);
  });

  test("by text looks at what the page says, in any case, and at who it comes from", () => {
    const one = event(1, { text: "glove-1 is busy" });
    expect(passes(one, { ...all, text: " ARBEITET " }, "glove-1 arbeitet")).toBe(true);
    expect(passes(one, { ...all, text: "Glove-1" }, "")).toBe(true);
    expect(passes(one, { ...all, text: "ur10" }, "glove-1 arbeitet")).toBe(false);
  });

  test("by source takes exactly that one", () => {
    expect(passes(event(1, { source: "glove-1" }), { ...all, source: "glove-1" }, "")).toBe(true);
    expect(passes(event(1, { source: "glove-10" }), { ...all, source: "glove-1" }, "")).toBe(false);
    expect(sourcesOf([event(1, { source: "b" }), event(2, { source: "a" }), event(3, { source: "b" })])).toEqual(["a", "b"]);
  });
});

describe("a reader's place", () => {
  test("is the newest while they follow", () => {
    expect(held([event(1), event(2)], null)).toEqual({ shown: [event(2), event(1)], waiting: 0 });
  });

  test("stays where it is while they read, and says how many have come", () => {
    const { shown, waiting } = held([event(1), event(2), event(3), event(4)], 2);
    expect(seqs(shown)).toEqual([2, 1]);
    expect(waiting).toBe(2);
  });
});

describe("taking along", () => {
  test("reads all pages backwards and ends", async () => {
    const kept = Array.from({ length: 7 }, (_, seq) => event(seq + 1));
    const asked: number[] = [];
    const page = (before: number) => {
      asked.push(before);
      return Promise.resolve(kept.filter((one) => one.seq < before).slice(-3));
    };
    expect(seqs(await allEvents(page))).toEqual([1, 2, 3, 4, 5, 6, 7]);
    expect(asked).toHaveLength(4);
  });

  test("writes a table that a spreadsheet reads, and no formulas", () => {
    const text = csv([event(1, { text: 'a "quoted", thing' }), event(2, { text: "=1+1", source: "line\nbreak" })]);
    expect(text.split("\r\n")).toEqual([
      "seq,at,level,source,key,text",
      '1,2026-01-01T08:00:00Z,info,glove-1,device.state,"a ""quoted"", thing"',
      '2,2026-01-01T08:00:00Z,info,"line\nbreak",device.state,\'=1+1',
      "",
    ]);
  });
});
