/**
* The furniture of the cell in the frame of the cell (metres): the table, bins, fixtures and the parts in them as
* boxes, derived from the positions that the trajectory tool gives, and the shapes of obstacles and zones.
 */

export type Triple = readonly [number, number, number];
export type Quaternion = readonly [x: number, y: number, z: number, w: number];

interface Spot {
  position: Triple;
  yaw_deg: number;
}

/** `GET /robots/{robot}/scene` of the trajectory tool, as far as it is drawn. */
export interface CellScene {
  name: string;
  bins: Record<string, { parts: Spot[] }>;
  fixtures: Record<string, { nests: Spot[] }>;
  parts: { part: string; place: string | null; position: Triple; orientation: Quaternion }[];
  /** Where the parts of a simulation are, whether or not the tool knows of them. */
  trueParts?: { size: Triple; position: Triple; orientation: Quaternion }[];
  shapes?: { kind: ShapeKind; name: string; form: Form; size: Triple; position: Triple; orientation: Quaternion }[];
}

export type ShapeKind = "obstacle" | "fence" | "camera" | "keepOut" | "reducedSpeed" | "people";
export type PieceKind = "table" | "bin" | "fixture" | "nest" | "part" | "truePart" | ShapeKind;
export type Form = "box" | "cylinder" | "sphere";

/** A shape, a box unless it says otherwise: its centre and its size along its own axes. */
export interface Piece {
  kind: PieceKind;
  name: string;
  form?: Form;
  size: Triple;
  position: Triple;
  orientation: Quaternion;
}

/** A part in the gripper, held at its centre across the fingers. */
export const PART_SIZE: Triple = [0.03, 0.075, 0.03];

const UPRIGHT: Quaternion = [0, 0, 0, 1];
const TABLE_M = 0.05;
const WALL_M = 0.012;
const BIN_HEIGHT_M = 0.11;
const ROOM_M = 0.075;
const NEST: Triple = [0.05, 0.085, 0.008];

/** The corners of the robot's base on the table. */
export type Footprint = readonly [least: readonly [x: number, y: number], most: readonly [x: number, y: number]];

const SMALL_FOOT: Footprint = [[0, 0], [0, 0]];
const AROUND_FOOT_M = 0.25;

/** The furniture of a scene; without a scene only the table below the robot. */
export function furnitureOf(scene: CellScene | null, foot: Footprint = SMALL_FOOT): Piece[] {
  const bins = Object.entries(scene?.bins ?? {}).flatMap(([name, bin]) => binPieces(name, bin.parts));
  const fixtures = Object.entries(scene?.fixtures ?? {}).flatMap(([name, { nests }]) => fixturePieces(name, nests));
  const parts = (scene?.parts ?? []).map(
    ({ part, position, orientation }): Piece => ({ kind: "part", name: part, size: PART_SIZE, position, orientation }),
  );
  const standing = [...bins, ...fixtures];
  const shapes = scene?.shapes ?? [];
  const ground = shapes.some(({ name }) => name === "table") ? [] : [table(standing, foot)];
  const simulated = (scene?.trueParts ?? []).map((part): Piece => ({ kind: "truePart", name: "simulated part", ...part }));
  return [...ground, ...shapes, ...standing, ...simulated, ...parts];
}

/** The table: below the robot and everything on it. */
function table(standing: readonly Piece[], [from, to]: Footprint): Piece {
  const corners: Triple[] = [
    [Math.min(from[0], -AROUND_FOOT_M), Math.min(from[1], -AROUND_FOOT_M), 0],
    [Math.max(to[0], AROUND_FOOT_M), Math.max(to[1], AROUND_FOOT_M), 0],
  ];
  const [least, most] = extent([...corners, ...standing.map((piece) => piece.position)], 0.28);
  return {
    kind: "table",
    name: "table",
    size: [most[0] - least[0], most[1] - least[1], TABLE_M],
    position: [(least[0] + most[0]) / 2, (least[1] + most[1]) / 2, -TABLE_M / 2],
    orientation: UPRIGHT,
  };
}

function binPieces(name: string, parts: readonly Spot[]): Piece[] {
  if (parts.length === 0) return [];
  const [least, most] = extent(parts.map((spot) => spot.position), ROOM_M);
  const [width, depth] = [most[0] - least[0], most[1] - least[1]];
  const [x, y] = [(least[0] + most[0]) / 2, (least[1] + most[1]) / 2];
  const box = (size: Triple, position: Triple): Piece => ({ kind: "bin", name, size, position, orientation: UPRIGHT });
  const z = BIN_HEIGHT_M / 2;
  return [
    box([width, depth, WALL_M], [x, y, WALL_M / 2]),
    box([width, WALL_M, BIN_HEIGHT_M], [x, least[1], z]),
    box([width, WALL_M, BIN_HEIGHT_M], [x, most[1], z]),
    box([WALL_M, depth, BIN_HEIGHT_M], [least[0], y, z]),
    box([WALL_M, depth, BIN_HEIGHT_M], [most[0], y, z]),
  ];
}

function fixturePieces(name: string, nests: readonly Spot[]): Piece[] {
  if (nests.length === 0) return [];
  const [least, most] = extent(nests.map((nest) => nest.position), 0.07);
  const top = Math.max(Math.min(...nests.map((nest) => nest.position[2])) - PART_SIZE[2] / 2 - NEST[2], 0.01);
  const plate: Piece = {
    kind: "fixture",
    name,
    size: [most[0] - least[0], most[1] - least[1], top],
    position: [(least[0] + most[0]) / 2, (least[1] + most[1]) / 2, top / 2],
    orientation: UPRIGHT,
  };
  const marks = nests.map(
    ({ position: [x, y], yaw_deg }): Piece => ({
      kind: "nest",
      name,
      size: NEST,
      position: [x, y, top + NEST[2] / 2],
      orientation: turned(yaw_deg),
    }),
  );
  return [plate, ...marks];
}

/** A rotation about the vertical axis. */
function turned(degrees: number): Quaternion {
  const half = (degrees * Math.PI) / 360;
  return [0, 0, Math.sin(half), Math.cos(half)];
}

/** The corners of the bounding box of `points` with a margin. */
function extent(points: readonly Triple[], room: number): [Triple, Triple] {
  const along = (axis: 0 | 1 | 2) => points.map((point) => point[axis]);
  return [
    [Math.min(...along(0)) - room, Math.min(...along(1)) - room, Math.min(...along(2))],
    [Math.max(...along(0)) + room, Math.max(...along(1)) + room, Math.max(...along(2))],
  ];
}
