import { renderHook } from "@testing-library/react";
import { act } from "react";
import { expect, test } from "vitest";
import { useStableOrder } from "./useStableOrder";

interface Row {
  id: string;
  value: number;
}

function list(ids: string, value = 0): Row[] {
  return Array.from(ids, (id) => ({ id, value }));
}

function props(rows: Row[], isHeld: boolean, signature = "") {
  return { rows, all: new Map(rows.map((row) => [row.id, row])), isHeld, signature };
}

test("a list keeps its order while it is read, appends rows below it, and shows the others on request", () => {
  const { result, rerender } = renderHook((given: ReturnType<typeof props>) => useStableOrder(given.rows, (row) => row.id, given.all, given.isHeld, given.signature), {
    initialProps: props(list("abc"), false),
  });
  const shown = () => result.current.rows.map((row) => row.id).join("");
  rerender(props(list("cab"), false));
  expect(shown()).toBe("cab");
  rerender(props(list("xbacy", 7), true));
  expect(shown()).toBe("caby");
  expect(result.current.rows[0]?.value).toBe(7);
  expect(result.current.waiting).toBe(1);
  act(() => result.current.release());
  expect(shown()).toBe("xbacy");
  rerender(props(list("ba"), true, "sorted by name"));
  expect(shown()).toBe("ba");
});
