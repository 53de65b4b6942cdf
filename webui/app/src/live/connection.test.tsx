import { afterEach, beforeEach, expect, test, vi } from "vitest";
import { LiveConnection, SILENT_AFTER_MS } from "./connection";
import { LiveStore } from "./store";

const batch = JSON.stringify({ type: "snapshot", at: "", topics: {}, events: [] });
let sockets: FakeSocket[] = [];

/** The WebSocket of the browser, whose server says what the test lets it say. */
class FakeSocket {
  static readonly OPEN = 1;
  readyState = 1;
  onopen: (() => void) | null = null;
  onmessage: ((message: { data: string }) => void) | null = null;
  onclose: (() => void) | null = null;
  readonly send = vi.fn();
  readonly close = vi.fn();

  constructor() {
    sockets.push(this);
  }
}

beforeEach(() => {
  sockets = [];
  vi.useFakeTimers();
  vi.stubGlobal("WebSocket", FakeSocket);
});

afterEach(() => {
  vi.useRealTimers();
  vi.unstubAllGlobals();
});

test("a server that hangs makes the page say that it is out of date, and its next message ends that", async () => {
  const store = new LiveStore();
  const connection = new LiveConnection(store, { url: "ws://cell/live", fetchEvents: () => Promise.resolve([]) });
  const [socket] = sockets;
  socket?.onopen?.();
  for (let second = 0; second < 5; second += 1) {
    socket?.onmessage?.({ data: batch });
    await vi.advanceTimersByTimeAsync(1000);
    expect(store.link).toBe("open");
  }
  await vi.advanceTimersByTimeAsync(SILENT_AFTER_MS - 1000 + 1);
  expect(store.link).toBe("lost");
  expect(socket?.close).not.toHaveBeenCalled();
  socket?.onmessage?.({ data: batch });
  expect(store.link).toBe("open");
  await vi.advanceTimersByTimeAsync(12_000);
  expect(socket?.close).toHaveBeenCalled();
  expect(store.link).toBe("lost");
  connection.close();
});
