import { expect, test } from "vitest";
import { BendHistory } from "./bend_history";

const bend = (value: number) => [value, value + 1, value + 2, value + 3, value + 4];

test("the strip shows what was seen, finger by finger", () => {
  const history = new BendHistory();
  history.push(1, bend(100));
  history.push(2, bend(200));
  const [times, thumb, , , , little] = history.columns();
  expect([...(times ?? [])]).toEqual([1, 2]);
  expect([...(thumb ?? [])]).toEqual([100, 200]);
  expect([...(little ?? [])]).toEqual([104, 204]);
});

test("what is older than the strip is dropped", () => {
  const history = new BendHistory(10, 30);
  for (let second = 0; second <= 100; second++) history.push(second, bend(second));
  const [times] = history.columns();
  expect(times?.[0]).toBe(90);
  expect(times?.at(-1)).toBe(100);
});

test("it never grows, however fast a glove sends and however long", () => {
  const history = new BendHistory(10, 30);
  const room = new Set<ArrayBufferLike>();
  for (let frame = 0; frame < 50_000; frame++) {
    history.push(frame / 200, bend(frame));
    for (const column of history.columns()) room.add(column.buffer);
  }
  expect(room.size).toBe(6);
  const [times, thumb] = history.columns();
  expect(times?.length).toBeLessThanOrEqual(300);
  expect(thumb?.at(-1)).toBe(49_999);
});
