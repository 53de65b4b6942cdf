import { act, renderHook } from "@testing-library/react";
import { afterEach, beforeEach, expect, test, vi } from "vitest";
import { useHistory } from "./history";

const ended = {
  id: "bin-picking-1", definition: "bin-picking", version: 1, name: "Bin picking 1", title: "Bin picking", key: null, status: "completed",
  reason: null, startedAt: "2026-01-31T08:00:00Z", endedAt: "2026-01-31T08:01:00Z",
};
const anything = { status: "", definition: "", involves: "" };

beforeEach(() => {
  vi.useFakeTimers();
});

afterEach(() => {
  vi.useRealTimers();
  vi.unstubAllGlobals();
});

test("a list that could not be read is asked for again", async () => {
  const answers = [new Response("{}", { status: 502 }), new Response(JSON.stringify([ended]), { headers: { "Content-Type": "application/json" } })];
  const fetched = vi.fn(() => Promise.resolve(answers.shift()));
  vi.stubGlobal("fetch", fetched);
  const { result } = renderHook(() => useHistory(anything, "", "newest"));
  await act(() => vi.advanceTimersByTimeAsync(0));
  expect(result.current.failure).not.toBeNull();
  await act(() => vi.advanceTimersByTimeAsync(60_000));
  expect(result.current.failure).toBeNull();
  expect(result.current.sections.ended.map((row) => row.id)).toEqual([ended.id]);
  expect(fetched).toHaveBeenCalledTimes(2);
});
