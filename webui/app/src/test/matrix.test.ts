import { expect, it } from "vitest";
import { columnsOf } from "./matrix";

it("shows a column for each gesture that was asked for, and for others only where something stands in them", () => {
  const recognized = ["Horns", "Thumbs up", "Ring straight", "no gesture", "nothing kept"];
  const counts = [
    [3, 0, 0, 1, 0],
    [0, 4, 0, 0, 0],
  ];
  expect(columnsOf({ asked: ["Horns", "Thumbs up"], recognized, counts })).toEqual([0, 1, 3]);
});
