import { describe, expect, it } from "vitest";
import { exchanged, partsOf, type Person } from "./people";

const anna: Person = {
  name: "anna",
  title: null,
  gloves: [],
  fits: {},
  commands: { "3": "Thumbs up", "8": "Horns" },
  ownCommands: {},
  ownGestures: {},
  faults: [],
};

describe("the gestures of a person", () => {
  it("are given to a command, and exchanged where another command had it", () => {
    expect(exchanged(anna, "3", "Little straight")).toEqual({ "3": "Little straight" });
    expect(exchanged(anna, "3", "Horns")).toEqual({ "3": "Horns", "8": "Thumbs up" });
    expect(exchanged(anna, "12", "Horns")).toEqual({ "12": "Horns", "8": null });
    expect(exchanged(anna, "3", null)).toEqual({ "3": null });
  });

  it("are shown by one hand, both hands, or two shapes in turn", () => {
    expect(partsOf({ name: "Horns", code: "20220", commandId: 8 })).toEqual([{ code: "20220", side: "right" }]);
    const up = { gesture: "Thumbs up", code: "02222" };
    expect(partsOf({ name: "Both", commandId: null, left: up, right: up })).toEqual([
      { code: "02222", side: "left" },
      { code: "02222", side: "right" },
    ]);
    expect(partsOf({ name: "Twice", commandId: null, sequence: [up, up] })).toHaveLength(2);
  });
});
