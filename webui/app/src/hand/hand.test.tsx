import { renderToStaticMarkup } from "react-dom/server";
import { describe, expect, it } from "vitest";
import { bendsOf, box, fingers, outline, overlap, shapeOf, type Point } from "./geometry";
import { Hand } from "./Hand";
import { HandShape } from "./HandShape";

const states = Array.from({ length: 243 }, (_, index) => index.toString(3).padStart(5, "0"));

describe("a hand", () => {
  it("looks different in each of the 243 states", () => {
    const drawings = new Set(states.map((state) => renderToStaticMarkup(<HandShape bends={bendsOf(state)} />)));
    expect(drawings.size).toBe(243);
  });

  it("is another one on the left, and says its fingers where it has no name", () => {
    const drawings = states.flatMap((state) => [
      renderToStaticMarkup(<Hand states={state} />),
      renderToStaticMarkup(<Hand states={state} side="left" />),
    ]);
    expect(new Set(drawings).size).toBe(486);
    expect(new Set(drawings.map((drawing) => drawing.replace(/aria-label="[^"]*"/, ""))).size).toBe(486);
  });

  it("begins with the hand it is animated from", () => {
    const shape = (markup: string) => markup.replace(/aria-label="[^"]*"/, "");
    const begun = renderToStaticMarkup(<Hand states="02222" animateFrom="00000" />);
    expect(shape(begun)).toBe(shape(renderToStaticMarkup(<Hand states="00000" />)));
  });

  it.each(states)("has no finger over another in %s", (state) => {
    const shapes = shapeOf(bendsOf(state)).map((shape) => shape.phalanges.map((phalanx) => outline(phalanx)));
    const crossed = fingers.flatMap((finger, index) =>
      fingers.slice(index + 1).filter((_, later) => {
        const [some, others] = [shapes[index] ?? [], shapes[index + 1 + later] ?? []];
        return some.some((first) => others.some((second) => overlap(first, second)));
      }).map((other) => `${finger} and ${other}`),
    );
    expect(crossed).toEqual([]);
  });

  it("lies within its box, whatever it shows", () => {
    const points = states.flatMap((state) =>
      shapeOf(bendsOf(state)).flatMap(({ phalanges }) => phalanges.flatMap((phalanx) => outline(phalanx))),
    );
    expect(Math.min(...points.map(([x]) => x))).toBeGreaterThan(4);
    expect(Math.max(...points.map(([x]) => x))).toBeLessThan(box.width - 4);
    expect(Math.min(...points.map(([, y]) => y))).toBeGreaterThan(4);
  });

  it("folds a bent finger over the palm with its nail visible, and hides the nail of a straight one", () => {
    const [, straight] = shapeOf(bendsOf("00000"));
    const [, bent] = shapeOf(bendsOf("02000"));
    expect(straight?.nail).toBeNull();
    expect(bent?.nail).not.toBeNull();
    const height = (points: readonly Point[]) => Math.min(...points.map(([, y]) => y));
    expect(height(bent?.nail ?? [])).toBeGreaterThan(150);
  });

  it("moves no finger by much for a small change of its bend", () => {
    for (let bend = 0; bend < 2; bend += 0.02) {
      const tips = (at: number) => shapeOf([at, at, at, at, at]).map(({ phalanges }) => phalanges[2].to);
      const [before, after] = [tips(bend), tips(bend + 0.02)];
      before.forEach(([x, y], index) => expect(Math.hypot((after[index]?.[0] ?? 0) - x, (after[index]?.[1] ?? 0) - y)).toBeLessThan(6));
    }
  });
});

describe("polygons", () => {
  const square = (x: number): Point[] => [[x, 0], [x + 10, 0], [x + 10, 10], [x, 10]];

  it("overlap when they share area, and do not when they only touch", () => {
    expect(overlap(square(0), square(9))).toBe(true);
    expect(overlap(square(0), square(10))).toBe(false);
    expect(overlap(square(0), square(30))).toBe(false);
  });
});
