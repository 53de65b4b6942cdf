import { describe, expect, it, vi } from "vitest";
import type { Batch, LiveEvent } from "./messages";
import { LiveStore } from "./store";

function batch(topics: Record<string, unknown>, events: LiveEvent[] = [], type: Batch["type"] = "batch"): Batch {
  return { type, at: "2026-01-01T00:00:00Z", topics, events };
}

function event(seq: number): LiveEvent {
  return { seq, at: "2026-01-01T00:00:00Z", level: "info", source: "test", key: "test", values: {}, text: `nr ${seq}` };
}

describe("the live store", () => {
  it("keeps the newest value of a topic and notifies only its listeners", () => {
    const live = new LiveStore();
    const hand = vi.fn();
    const robot = vi.fn();
    live.watch("glove/glove-1", hand);
    live.watch("robot/ur10-1", robot);
    live.apply(batch({ "glove/glove-1": { battery: 0.5 } }));
    expect(live.value("glove/glove-1")).toEqual({ battery: 0.5 });
    expect(hand).toHaveBeenCalledOnce();
    expect(robot).not.toHaveBeenCalled();
  });

  it("forgets what a snapshot does not name", () => {
    const live = new LiveStore();
    live.apply(batch({ "alert/a": 1, "alert/b": 2 }, [], "snapshot"));
    live.apply(batch({ "alert/b": 3 }, [], "snapshot"));
    expect(live.list("alert")).toEqual([3]);
    expect(live.value("alert/a")).toBeUndefined();
  });

  it("gives the same list until something in the family changes", () => {
    const live = new LiveStore();
    live.apply(batch({ "robot/b": 2, "robot/a": 1, "robot/a/joints": 9 }));
    const list = live.list("robot");
    expect(list).toEqual([1, 2]);
    live.apply(batch({ "glove/g": 1 }));
    expect(live.list("robot")).toBe(list);
    live.apply(batch({ "robot/a": null }));
    expect(live.list("robot")).toEqual([2]);
  });

  it("has each event once and in order, however they come, and only so many", () => {
    const live = new LiveStore();
    live.apply(batch({}, [event(1), event(2)]));
    live.apply(batch({}, [event(6)]));
    live.addEvents([event(2), event(3), event(4), event(5), event(6)]);
    expect(live.events.map((event) => event.seq)).toEqual([1, 2, 3, 4, 5, 6]);
    live.addEvents(Array.from({ length: 2000 }, (_, index) => event(7 + index)));
    expect(live.events.length).toBe(500);
    expect(live.events.at(-1)?.seq).toBe(2006);
  });

  it("wants a topic as long as anybody does, and lets go of its value then", () => {
    const live = new LiveStore();
    live.onSubscriptionsChange = vi.fn();
    const first = live.subscribe("robot/a/joints");
    const second = live.subscribe("robot/a/joints");
    live.apply(batch({ "robot/a/joints": 1 }));
    first();
    expect(live.subscriptions).toEqual(["robot/a/joints"]);
    second();
    expect(live.subscriptions).toEqual([]);
    expect(live.value("robot/a/joints")).toBeUndefined();
    expect(live.onSubscriptionsChange).toHaveBeenCalledTimes(2);
  });

  it("forgets the registered devices when no page shows them", () => {
    const live = new LiveStore();
    const release = live.subscribe("registeredDevices");
    live.apply(batch({ registeredDevices: { isCurrent: true }, "registeredDevice/a": 1, "device/a": 2 }));
    expect(live.list("registeredDevice")).toEqual([1]);
    release();
    expect(live.list("registeredDevice")).toEqual([]);
    expect(live.list("device")).toEqual([2]);
  });

  it("lets no watcher pile up", () => {
    const live = new LiveStore();
    const listener = vi.fn();
    live.watch("x/1", listener)();
    live.watchFamily("x", listener)();
    live.apply(batch({ "x/1": 1 }));
    expect(listener).not.toHaveBeenCalled();
  });
});
