import { describe, expect, it, vi } from "vitest";
import { Driver } from "~/control/driver";
import { needsRestart } from "./holders";
import { hullOf, inFrame, onGround, shownBall, soleAt, supportPolygon, type FootState, type LiveDocument, type Pair } from "./humanoid";
import { wishOf } from "./wish";
import { Replay } from "./replay";
import { throttled } from "./snapshots";

const foot = (share: number): FootState => ({ force: null, pressure: null, share });
const sole = (y: number): Pair[] => [[-0.05, y - 0.02], [0.1, y - 0.02], [0.1, y + 0.02], [-0.05, y + 0.02]];
const soles = { left: sole(0.1), right: sole(-0.1) };

function area(polygon: readonly Pair[]): number {
  return polygon.reduce((sum, [x, y], index) => {
    const [nextX, nextY] = polygon[(index + 1) % polygon.length] ?? [x, y];
    return sum + (x * nextY - nextX * y) / 2;
  }, 0);
}

describe("the ground of the humanoid", () => {
  it("turns places into the frame of the feet and back", () => {
    const frame = [1, 0, Math.PI] as const;
    expect(inFrame(frame, [0.2, 0, 0.5])[0]).toBeCloseTo(0.8);
    const there = onGround(frame, inFrame(frame, [0.3, -0.7, 0.4]));
    [0.3, -0.7, 0.4].forEach((value, index) => expect(there[index]).toBeCloseTo(value));
  });

  it("spans the support between both soles, or one in single support", () => {
    const feet = { left: foot(0.2), right: foot(0.8) };
    expect(area(supportPolygon({ phase: "standing", feet }, soles))).toBeCloseTo(0.15 * 0.24);
    const single = supportPolygon({ phase: "single", feet }, soles);
    expect(area(single)).toBeCloseTo(0.15 * 0.04);
    expect(Math.max(...single.map(([, y]) => y))).toBeCloseTo(-0.08);
    expect(supportPolygon({ phase: "single", feet }, {})).toEqual([]);
  });

  it("turns a sole about the place where its foot lands", () => {
    const [toe, heel] = soleAt([1, 2, Math.PI / 2], [[0.13, 0.05, 0], [-0.07, 0.05, 0]]);
    [0.95, 2.13].forEach((value, index) => expect(toe?.[index]).toBeCloseTo(value));
    [0.95, 1.93].forEach((value, index) => expect(heel?.[index]).toBeCloseTo(value));
  });

  it("has every point within its hull", () => {
    const points: Pair[] = Array.from({ length: 60 }, (_, index) => [Math.sin(index * 12.9898) * 2, Math.cos(index * 78.233)]);
    const hull = hullOf(points);
    for (const [x, y] of points) {
      hull.forEach(([ax, ay], index) => {
        const [bx, by] = hull[(index + 1) % hull.length] ?? [ax, ay];
        expect((bx - ax) * (y - ay) - (by - ay) * (x - ax)).toBeGreaterThanOrEqual(-1e-12);
      });
    }
  });
});

describe("the control", () => {
  it("is started again when it has ended, and when its joints hold for good", () => {
    const live = (mode: LiveDocument["mode"], code?: string) => ({ mode, fault: code === undefined ? null : { code, message: "" } }) as LiveDocument;
    expect([live("following"), live("stopped"), live("standing", "fault3")].some(needsRestart)).toBe(false);
    expect([live("holding", "fault1"), live("down", "fault4"), live(null, "cycleEnded")].every(needsRestart)).toBe(true);
  });
});

it("a ball is shown while the robot juggles, and until it has flown", () => {
  const ball = (phase: string) => ({ phase }) as LiveDocument["ball"];
  const isShown = (behaviour: LiveDocument["behaviour"], phase: string) => shownBall({ behaviour, ball: ball(phase) }) !== null;
  expect([isShown("juggling", "caught"), isShown("walking", "flying"), isShown("assistedWalking", "caught"), isShown("standing", "landed")]).toEqual([true, true, false, false]);
});

describe("the wish of the therapist", () => {
  it("is at rest unless the control is held, and full speed is that of the service", () => {
    const driver = new Driver(() => []);
    driver.set({ speed: 1 });
    expect(wishOf(driver.input())).toEqual({ kind: "wish", ahead: 0, left: 0, yaw: 0, held: false });
    driver.hold(true);
    driver.push("x", 1);
    driver.push("rz", -0.5);
    const wish = wishOf(driver.input());
    expect(wish.held).toBe(true);
    expect(wish.ahead).toBeCloseTo(0.2);
    expect(wish.yaw).toBeCloseTo(-0.15);
  });
});

describe("snapshots for panels", () => {
  it("change less often than the store, and end with the newest", () => {
    vi.useFakeTimers();
    const listeners = new Set<() => void>();
    let value = 0;
    const store = throttled({ subscribe: (listener) => (listeners.add(listener), () => listeners.delete(listener)), snapshot: () => value }, 100);
    const seen: number[] = [];
    const end = store.subscribe(() => seen.push(store.snapshot()));
    for (let count = 0; count < 20; count += 1) {
      value += 1;
      for (const listener of listeners) listener();
      vi.advanceTimersByTime(10);
    }
    vi.advanceTimersByTime(200);
    end();
    expect(seen.length).toBeLessThan(5);
    expect(seen.at(-1)).toBe(20);
    expect(listeners.size).toBe(0);
    vi.useRealTimers();
  });
});

describe("a replay", () => {
  const part = (fromS: number, durationS: number) => {
    const count = Math.max(0, Math.min(20, durationS - fromS));
    const frames = Array.from({ length: count * 10 }, (_, index) => ({ t: fromS + index / 10, document: { t: fromS + index / 10 } }));
    return { durationS, frames, nextFrom: fromS + count < durationS ? fromS + count : null };
  };

  it("shows the frame of its time, fetches what follows, and ends at the end", async () => {
    const asked: number[] = [];
    const replay = new Replay((fromS) => (asked.push(fromS), Promise.resolve(part(fromS, 30))), () => undefined);
    replay.advance(0);
    await vi.waitFor(() => expect(replay.snapshot().phase).toBe("open"));
    expect(replay.snapshot().document?.t).toBe(0);
    replay.advance(2050);
    expect(replay.snapshot().positionS).toBeCloseTo(2.05);
    expect(replay.snapshot().document?.t).toBe(2);
    expect(asked).toEqual([0]);
    replay.seek(18);
    replay.advance(2060);
    await vi.waitFor(() => expect(asked).toEqual([0, 20]));
    let nowMs = 3000;
    await vi.waitFor(() => {
      replay.advance((nowMs += 5000));
      expect(replay.snapshot()).toMatchObject({ positionS: 30, isPlaying: false });
    });
    expect(replay.snapshot().document?.t).toBeCloseTo(29.9);
    replay.play(true);
    expect(replay.snapshot()).toMatchObject({ positionS: 0, isPlaying: true });
  });

  it("asks for frames of the screen only while it plays or fetches, and a pause takes no time of it", async () => {
    const frames: ((nowMs: number) => void)[] = [];
    vi.stubGlobal("requestAnimationFrame", (callback: (nowMs: number) => void) => frames.push(callback));
    vi.stubGlobal("cancelAnimationFrame", () => undefined);
    const replay = new Replay((fromS) => Promise.resolve(part(fromS, 8)), () => undefined);
    const end = replay.subscribe(() => undefined);
    frames.shift()?.(0);
    await vi.waitFor(() => expect(replay.snapshot().phase).toBe("open"));
    frames.shift()?.(1000);
    expect(replay.snapshot().positionS).toBe(1);
    replay.play(false);
    frames.shift()?.(1016);
    expect(frames).toHaveLength(0);
    replay.seek(2);
    frames.shift()?.(5000);
    expect(frames).toHaveLength(0);
    replay.play(true);
    frames.shift()?.(90_000);
    frames.shift()?.(90_500);
    expect(replay.snapshot().positionS).toBe(2.5);
    expect(frames).toHaveLength(1);
    end();
    vi.unstubAllGlobals();
  });

  it("says why frames cannot be fetched, and asks no further", async () => {
    const failures: unknown[] = [];
    const replay = new Replay(() => Promise.reject(new Error("it still runs")), (error) => failures.push(error));
    replay.advance(0);
    await vi.waitFor(() => expect(replay.snapshot().phase).toBe("lost"));
    replay.advance(10);
    expect(failures).toHaveLength(1);
  });
});
