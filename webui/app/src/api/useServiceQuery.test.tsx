import { act, renderHook } from "@testing-library/react";
import { afterEach, beforeEach, expect, test, vi } from "vitest";
import { useServiceQuery } from "./useServiceQuery";

beforeEach(() => {
  vi.useFakeTimers();
});

afterEach(() => {
  vi.useRealTimers();
  vi.unstubAllGlobals();
});

/** Return how often `path` is requested in a minute, if the server answers 404 with `problem`. */
async function requestsInAMinute(path: string, problem: object): Promise<number> {
  const headers = { "Content-Type": "application/problem+json" };
  const sent = vi.fn<typeof fetch>(() => Promise.resolve(new Response(JSON.stringify(problem), { status: 404, headers })));
  vi.stubGlobal("fetch", sent);
  const { result, unmount } = renderHook(() => useServiceQuery("ros-bridge", path, { intervalMs: 2000 }));
  await act(() => vi.advanceTimersByTimeAsync(60_000));
  expect(result.current.failure).toBe("It does not exist");
  unmount();
  return sent.mock.calls.length;
}

test("a service that the cell does not have is asked once, a resource that may be added is polled", async () => {
  const detail = "It does not exist";
  expect(await requestsInAMinute("rules", { title: "No such service", detail, detailCode: "page.no_such_service" })).toBe(1);
  expect(await requestsInAMinute("rules/belt", { title: "Not found", detail })).toBeGreaterThan(20);
});
