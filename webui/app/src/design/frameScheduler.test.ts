import { afterEach, beforeEach, describe, expect, it, vi } from "vitest";
import { FrameScheduler } from "./frameScheduler";

const SCREEN_MS = 1000 / 60;
const PERIOD_MS = 48;

/** The page of a browser with a screen of 60 Hz: its frames, and whether it and the element are seen. */
class Browser {
  readonly #frames = new Map<number, ReturnType<typeof setTimeout>>();
  readonly #listeners = new Set<() => void>();
  #count = 0;
  #onIntersection: (entries: { isIntersecting: boolean }[]) => void = () => undefined;

  constructor() {
    const onIntersection = (callback: (entries: { isIntersecting: boolean }[]) => void) => (this.#onIntersection = callback);
    vi.stubGlobal("requestAnimationFrame", (callback: (nowMs: number) => void) => {
      const dueMs = (Math.floor(performance.now() / SCREEN_MS) + 1) * SCREEN_MS;
      this.#frames.set(++this.#count, setTimeout(() => callback(dueMs), dueMs - performance.now()));
      return this.#count;
    });
    vi.stubGlobal("cancelAnimationFrame", (frame: number) => clearTimeout(this.#frames.get(frame)));
    vi.stubGlobal("document", {
      hidden: false,
      addEventListener: (_: string, listener: () => void) => this.#listeners.add(listener),
      removeEventListener: (_: string, listener: () => void) => this.#listeners.delete(listener),
    });
    vi.stubGlobal(
      "IntersectionObserver",
      class {
        constructor(callback: (entries: { isIntersecting: boolean }[]) => void) {
          onIntersection(callback);
        }
        observe() {
          // A test says when the element is seen.
        }
        disconnect() {
          onIntersection(() => undefined);
        }
      },
    );
  }

  hide(isHidden: boolean): void {
    Object.assign(document, { hidden: isHidden });
    for (const listener of this.#listeners) listener();
  }

  scroll(...isIntersecting: boolean[]): void {
    this.#onIntersection(isIntersecting.map((each) => ({ isIntersecting: each })));
  }

  get listeners(): number {
    return this.#listeners.size;
  }
}

let browser: Browser;
let drawn: number[];

beforeEach(() => {
  vi.useFakeTimers({ toFake: ["setTimeout", "clearTimeout", "performance"] });
  browser = new Browser();
  drawn = [];
});

afterEach(() => {
  vi.useRealTimers();
  vi.unstubAllGlobals();
});

function scheduler({ periodMs = 0, continues = () => false }: { periodMs?: number; continues?: () => boolean } = {}): FrameScheduler {
  const draw = () => {
    drawn.push(performance.now());
    return continues();
  };
  return new FrameScheduler({} as Element, draw, periodMs);
}

/** Call `each` every `everyMs` for `durationMs`. */
function stream(each: () => void, everyMs: number, durationMs: number): void {
  for (let passedMs = 0; passedMs < durationMs; passedMs += everyMs) {
    each();
    vi.advanceTimersByTime(everyMs);
  }
}

describe("a view that is drawn on request", () => {
  it("is drawn once with the next frame of the screen, however often it was asked for", () => {
    const frames = scheduler();
    for (let count = 0; count < 10; count += 1) frames.request();
    vi.advanceTimersByTime(SCREEN_MS + 1);
    expect(drawn).toHaveLength(1);
    vi.advanceTimersByTime(1000);
    expect(drawn).toHaveLength(1);
  });

  it("follows a stream with every state where pictures are cheap, and 20 times a second where they are dear", () => {
    const fast = scheduler();
    stream(fast.request, 1000 / 30, 2000);
    expect(drawn.length).toBeGreaterThanOrEqual(59);
    fast.dispose();
    drawn = [];
    const slow = scheduler({ periodMs: PERIOD_MS });
    stream(slow.request, 1000 / 30, 2000);
    expect(drawn.length).toBeLessThanOrEqual(41);
    expect(drawn.length).toBeGreaterThanOrEqual(30);
  });

  it("shows the last state of a stream that ends within the period", () => {
    const frames = scheduler({ periodMs: PERIOD_MS });
    frames.request();
    vi.advanceTimersByTime(20);
    frames.request();
    const askedMs = performance.now();
    vi.advanceTimersByTime(PERIOD_MS + SCREEN_MS);
    expect(drawn).toHaveLength(2);
    expect(drawn[1]).toBeGreaterThan(askedMs);
  });

  it("answers a person with the next frame, although the period has not passed", () => {
    const frames = scheduler({ periodMs: PERIOD_MS });
    frames.request();
    vi.advanceTimersByTime(20);
    frames.request(); // waits for the period
    const turnedMs = performance.now();
    frames.requestNow();
    frames.requestNow();
    vi.advanceTimersByTime(SCREEN_MS + 1);
    expect(drawn).toHaveLength(2);
    expect((drawn[1] ?? Infinity) - turnedMs).toBeLessThanOrEqual(SCREEN_MS + 1);
    vi.advanceTimersByTime(1000);
    expect(drawn, "the waiting request was answered too").toHaveLength(2);
  });

  it("is drawn with each frame while a person turns it beside a stream", () => {
    const frames = scheduler({ periodMs: PERIOD_MS });
    let count = 0;
    const move = () => {
      if (count++ % 2 === 0) frames.request();
      frames.requestNow();
    };
    stream(move, SCREEN_MS, 1000);
    expect(drawn.length).toBeGreaterThanOrEqual(58);
  });

  it("continues by itself while it moves, no faster than its period", () => {
    let left = 5;
    const frames = scheduler({ periodMs: PERIOD_MS, continues: () => --left > 0 });
    frames.request();
    vi.advanceTimersByTime(2000);
    expect(drawn).toHaveLength(5);
    expect((drawn[4] ?? 0) - (drawn[0] ?? 0)).toBeGreaterThanOrEqual(4 * PERIOD_MS);
  });

  it("needs no further frame for what drawing itself changes", () => {
    const frames: FrameScheduler = scheduler({
      continues: () => {
        frames.request();
        frames.requestNow();
        return false;
      },
    });
    frames.request();
    vi.advanceTimersByTime(1000);
    expect(drawn).toHaveLength(1);
  });
});

describe("a view that nobody can see", () => {
  it.each<[string, (isSeen: boolean) => void]>([
    ["on a hidden page", (isSeen) => browser.hide(!isSeen)],
    ["out of the viewport", (isSeen) => browser.scroll(isSeen)],
    ["scrolled through at once", (isSeen) => browser.scroll(!isSeen, isSeen)],
  ])("is not drawn %s, and at once when it is seen again", (_, see) => {
    const frames = scheduler({ periodMs: PERIOD_MS });
    see(false);
    stream(frames.request, 30, 1000);
    frames.requestNow();
    vi.advanceTimersByTime(100);
    expect(drawn).toHaveLength(0);
    see(true);
    vi.advanceTimersByTime(SCREEN_MS + 1);
    expect(drawn).toHaveLength(1);
  });

  it("does not draw what waited for the period when it was hidden", () => {
    const frames = scheduler({ periodMs: PERIOD_MS });
    frames.request();
    vi.advanceTimersByTime(20);
    frames.request();
    browser.hide(true);
    vi.advanceTimersByTime(1000);
    expect(drawn).toHaveLength(1);
  });

  it("is never drawn again once it is gone", () => {
    const frames = scheduler({ periodMs: PERIOD_MS });
    frames.request();
    frames.dispose();
    frames.request();
    frames.requestNow();
    browser.hide(false);
    vi.advanceTimersByTime(1000);
    expect(drawn).toHaveLength(0);
    expect(browser.listeners).toBe(0);
  });
});
