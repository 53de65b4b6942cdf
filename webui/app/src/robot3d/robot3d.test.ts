import { describe, expect, test } from "vitest";
import { type CellScene, furnitureOf, PART_SIZE, type PieceKind } from "./furniture";
import { JointTrack } from "./joint_track";
import { DISTANCES, type Point, stepOf, stepped } from "./orbit";

describe("joints between two states", () => {
  test("begin where the robot is, without a sweep from zero", () => {
    const track = new JointTrack();
    expect(track.at(0)).toEqual([]);
    track.push([1, 2], 1000);
    expect(track.at(1000)).toEqual([1, 2]);
  });

  test("glide to a new state in the time that it took to come", () => {
    const track = new JointTrack();
    track.push([0], 1000);
    track.push([1], 1040);
    expect(track.at(1040)).toEqual([0]);
    expect(track.at(1060)[0]).toBeCloseTo(0.5);
    expect(track.glides(1060)).toBe(true);
    expect(track.at(1080)).toEqual([1]);
    expect(track.glides(1080)).toBe(false);
  });

  test("never jump when a state comes early", () => {
    const track = new JointTrack();
    track.push([0], 0);
    track.push([1], 100);
    const before = track.at(150);
    track.push([2], 150);
    expect(track.at(150)).toEqual(before);
  });

  test("of a robot at rest need no drawing", () => {
    const track = new JointTrack();
    expect(track.push([0.5, 0.5], 0)).toBe(true);
    expect(track.push([0.5, 0.5000001], 33)).toBe(false);
    expect(track.glides(34)).toBe(false);
  });

  test("are reached soon after a long silence", () => {
    const track = new JointTrack();
    track.push([0], 0);
    track.push([3], 60_000);
    expect(track.at(60_300)).toEqual([3]);
  });
});

describe("the view turned with keys", () => {
  const target: Point = [0, 0, 0];
  const away = (camera: Point) => Math.hypot(...camera);

  test("keeps its distance while it turns", () => {
    const camera = stepped([2, 0, 1], target, { right: 1, up: 0.1 });
    expect(away(camera)).toBeCloseTo(Math.hypot(2, 1));
  });

  test("stays above the ground, below the zenith, and within the distance limits", () => {
    let camera: Point = [2, 0, 1];
    for (let step = 0; step < 100; step++) camera = stepped(camera, target, { up: 0.2, distance: 1.2 });
    expect(camera[2]).toBeGreaterThan(0);
    expect(Math.hypot(camera[0], camera[1])).toBeGreaterThan(0);
    expect(away(camera)).toBeCloseTo(DISTANCES.most);
    for (let step = 0; step < 100; step++) camera = stepped(camera, target, { up: -0.2, distance: 0.8 });
    expect(camera[2]).toBeGreaterThan(-0.1);
    expect(away(camera)).toBeCloseTo(DISTANCES.least);
  });

  test("leaves other keys alone", () => {
    expect(stepOf("Tab")).toBeNull();
    expect(stepOf("0")).toBe("reset");
    expect(stepOf("ArrowLeft")).not.toBeNull();
  });
});

describe("what stands round the robot", () => {
  const scene: CellScene = {
    name: "a cell",
    bins: { "bin-1": { parts: [{ position: [-0.6, -0.5, 0.09], yaw_deg: 0 }, { position: [-0.5, -0.6, 0.05], yaw_deg: 0 }] } },
    fixtures: { "fixture-1": { nests: [{ position: [-0.6, 0.4, 0.06], yaw_deg: 90 }] } },
    parts: [{ part: "part-1", place: "bin-1", position: [-0.6, -0.5, 0.09], orientation: [1, 0, 0, 0] }],
  };

  test("is a table without a scene", () => {
    expect(furnitureOf(null).map((piece) => piece.kind)).toEqual(["table"]);
  });

  test("is a table as long as the foot of the robot", () => {
    const [table] = furnitureOf(null, [[-0.1, -0.2], [0.1, 1.8]]);
    expect(table?.size[1]).toBeGreaterThan(2.05);
    expect(table?.position[1]).toBeCloseTo(0.775);
  });

  test("is a bin round its parts, a fixture under its nests, and the parts themselves", () => {
    const pieces = furnitureOf(scene);
    const those = (kind: PieceKind) => pieces.filter((piece) => piece.kind === kind);
    expect(those("bin")).toHaveLength(5);
    expect(those("fixture")).toHaveLength(1);
    expect(those("nest")).toHaveLength(1);
    expect(those("part")).toHaveLength(1);
    const part = those("part")[0];
    const walls = those("bin").map((wall) => wall.position[0]);
    expect(Math.min(...walls)).toBeLessThan((part?.position[0] ?? 0) - PART_SIZE[1] / 2);
  });

  test("carries a part in its nest: what lies there touches it", () => {
    const nest = furnitureOf(scene).find((piece) => piece.kind === "nest");
    const top = (nest?.position[2] ?? 0) + (nest?.size[2] ?? 0) / 2;
    expect(top).toBeCloseTo(0.06 - PART_SIZE[2] / 2);
  });

  test("is the obstacles and zones of the scene, and its own table in place of ours", () => {
    const shape = { form: "box", size: [1, 1, 0.1], position: [0, 0, -0.1], orientation: [0, 0, 0, 1] } as const;
    const shapes = [{ kind: "obstacle", name: "table", ...shape }, { kind: "keepOut", name: "gap", ...shape }] as const;
    const pieces = furnitureOf({ ...scene, shapes: [...shapes] });
    expect(pieces.filter((piece) => piece.kind === "table")).toHaveLength(0);
    expect(pieces.slice(0, 2).map((piece) => piece.kind)).toEqual(["obstacle", "keepOut"]);
  });

  test("stands on the table, all of it", () => {
    const [table, ...others] = furnitureOf(scene);
    for (const piece of others) {
      expect(Math.abs(piece.position[0] - (table?.position[0] ?? 0))).toBeLessThan((table?.size[0] ?? 0) / 2);
      expect(Math.abs(piece.position[1] - (table?.position[1] ?? 0))).toBeLessThan((table?.size[1] ?? 0) / 2);
    }
  });

  test("draws the parts of a simulation beside those that are known, each with its own size", () => {
    const part = { size: [0.024, 0.06, 0.024], position: [0.1, 0.2, 0.05], orientation: [0, 0, 0, 1] } as const;
    const pieces = furnitureOf({ ...scene, trueParts: [part] });
    expect(pieces.filter((piece) => piece.kind === "truePart")).toEqual([{ kind: "truePart", name: "simulated part", ...part }]);
    expect(pieces.filter((piece) => piece.kind === "part")).toHaveLength(scene.parts.length);
  });
});
