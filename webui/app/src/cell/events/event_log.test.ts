import { describe, expect, test } from "vitest";
import type { LiveEvent } from "~/live/messages";
import { allEvents, csv, merged, passes, sourcesOf } from "./event_log";

function event(seq: number, rest: Partial<LiveEvent> = {}): LiveEvent {
  return {
    seq, at: "2026-01-01T08:00:00Z", level: "info", source: "glove-1", key: "device.state", values: {},
    text: `event ${seq}`, ...rest,
  };
}

const all = { level: "", source: "", text: "" } as const;
const seqs = (events: readonly LiveEvent[]) => events.map((event) => event.seq);

describe("merging", () => {
  test("joins older and newer events, each once, sorted", () => {
    expect(seqs(merged([event(4), event(5)], [event(2), event(4), event(6)]))).toEqual([2, 4, 5, 6]);
  });

  test("keeps only the newest", () => {
    expect(seqs(merged([event(1), event(2)], [event(3), event(4)], 3))).toEqual([2, 3, 4]);
  });

  test("returns the same list without new events", () => {
    const known = [event(1), event(2)];
    expect(merged(known, [event(2)])).toBe(known);
    expect(merged(known, [])).toBe(known);
  });

  test("leaves no gap when the connection drops events that the page still has", () => {
    const early = merged([], [event(1), event(2), event(3)]);
    expect(seqs(merged(early, [event(3), event(4)]))).toEqual([1, 2, 3, 4]);
  });
});

describe("filtering", () => {
  test("by level includes higher levels", () => {
    const levels = (["info", "attention", "stop"] as const).map((level, seq) => event(seq, { level }));
    const passing = (level: "" | "attention" | "stop") =>
      levels.filter((each) => passes(each, { ...all, level }, "")).map((each) => each.level);
    expect(passing("")).toEqual(["info", "attention", "stop"]);
    expect(passing("attention")).toEqual(["attention", "stop"]);
    expect(passing("stop")).toEqual(["stop"]);
  });

  test("by text searches the displayed text and the source, ignoring case", () => {
    const each = event(1, { text: "glove-1 is busy" });
    expect(passes(each, { ...all, text: " ARBEITET " }, "glove-1 arbeitet")).toBe(true);
    expect(passes(each, { ...all, text: "Glove-1" }, "")).toBe(true);
    expect(passes(each, { ...all, text: "ur10" }, "glove-1 arbeitet")).toBe(false);
  });

  test("by source matches exactly", () => {
    expect(passes(event(1, { source: "glove-1" }), { ...all, source: "glove-1" }, "")).toBe(true);
    expect(passes(event(1, { source: "glove-10" }), { ...all, source: "glove-1" }, "")).toBe(false);
    expect(sourcesOf([event(1, { source: "b" }), event(2, { source: "a" }), event(3, { source: "b" })])).toEqual(["a", "b"]);
  });
});

describe("export", () => {
  test("reads all pages backwards", async () => {
    const kept = Array.from({ length: 7 }, (_, seq) => event(seq + 1));
    const asked: number[] = [];
    const page = (before: number) => {
      asked.push(before);
      return Promise.resolve(kept.filter((each) => each.seq < before).slice(-3));
    };
    expect(seqs(await allEvents(page))).toEqual([1, 2, 3, 4, 5, 6, 7]);
    expect(asked).toHaveLength(4);
  });

  test("writes CSV without formulas", () => {
    const text = csv([event(1, { text: 'a "quoted", thing' }), event(2, { text: "=1+1", source: "line\nbreak" })]);
    expect(text.split("\r\n")).toEqual([
      "seq,at,level,source,key,text",
      '1,2026-01-01T08:00:00Z,info,glove-1,device.state,"a ""quoted"", thing"',
      '2,2026-01-01T08:00:00Z,info,"line\nbreak",device.state,\'=1+1',
      "",
    ]);
  });
});
