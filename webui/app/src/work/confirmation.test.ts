import { describe, expect, it } from "vitest";
import type { GloveView } from "~/live/messages";
import { startRequest, waitAfter, waiting, type Wait } from "./confirmation";
import { glove, task } from "./scene.fixture";

const open = glove({ states: "00000" });
const up = (heldMs: number, part: Partial<GloveView> = {}) =>
  glove({ states: "02222", hold: { gesture: "Thumbs up", heldMs, announceMs: 500, confirmMs: 1500, spent: false }, ...part });
const after = (...views: GloveView[]): Wait => views.reduce((wait, view) => waitAfter(wait, view), waiting);

describe("a hold that starts a process", () => {
  it("counts when it is held to the end", () => {
    expect(after(open, up(40), up(1480)).counted).toBe(false);
    expect(after(open, up(40), up(1480), up(1510)).counted).toBe(true);
  });

  it("counts where the controller has taken it for a command already", () => {
    expect(after(open, up(1460), up(0, { hold: { ...up(0).hold, spent: true } })).counted).toBe(true);
  });

  it("does not count when the hand showed it before the page began to wait", () => {
    expect(after(up(1600)).counted).toBe(false);
    expect(after(up(1600), up(9000)).counted).toBe(false);
  });

  it("does not count while it is spent from the Task before", () => {
    const spent = up(0, { hold: { ...up(0).hold, spent: true } });
    expect(after(spent, spent).counted).toBe(false);
  });

  it("does not count when a finger moves in between", () => {
    expect(after(open, up(1400), glove({ states: "02212" }), up(300)).counted).toBe(false);
  });

  it.each([
    ["in testing mode", { testing: true }],
    ["while paused", { paused: true }],
    ["with a Task", { task }],
    ["without the glove", { connected: false }],
  ])("does not count %s", (_, part) => {
    expect(after(open, up(1600, part)).counted).toBe(false);
    expect(after(glove(part), up(1600)).counted).toBe(false);
  });

  it("has one key for all screens of a glove, and another after each process", () => {
    expect(startRequest("glove-1", "bin-picking", "p-1")).toBe(startRequest("glove-1", "bin-picking", "p-1"));
    expect(startRequest("glove-1", "bin-picking", "p-1")).not.toBe(startRequest("glove-1", "bin-picking", "p-2"));
    expect(startRequest("glove-1", "bin-picking", null)).toMatch(/^[0-9a-f]{12}$/);
    expect(startRequest("glove-1", "bin-picking", null)).not.toBe(startRequest("glove-2", "bin-picking", null));
  });
});
