/**
 * The hand as a shape: five finger states become the outlines of three phalanges a finger, over a palm.
 *
* The view is the palm of a right hand, fingers up, thumb at the right; a left hand is its mirror image. A finger
* bends in depth, towards the viewer: its phalanges shorten, and past a right angle lie over the palm with the
 * nail visible. The thumb bends across the palm, below the folded fingers.
 */
import type { Finger } from "~/live/messages";
// The proportions: the gesture controller draws its pictures from the same file (pictures/hand.json there).
import hand from "./hand.json";

export type Point = readonly [x: number, y: number];
export type Side = "left" | "right";
/** The bend of a finger: 0 straight, 1 between, 2 bent; fractions while it moves. */
export type Bend = number;

export interface Phalanx {
  from: Point;
  to: Point;
  /** Half the width at either end. */
  fromRadius: number;
  toRadius: number;
  /** Its back faces the viewer, and it covers what is below. */
  folded: boolean;
}

export interface FingerShape {
  finger: Finger;
  phalanges: readonly [Phalanx, Phalanx, Phalanx];
  /** The nail, if it is visible. */
  nail: readonly Point[] | null;
  /** The creases of the joints, if they are visible. */
  creases: readonly (readonly [Point, Point])[];
}

export const fingers: readonly Finger[] = ["thumb", "index", "middle", "ring", "little"];

/** The box that contains the drawing. */
export const box = hand.box;

interface Anatomy {
  knuckle: Point;
  /** The angle from vertical towards the thumb, in degrees. */
  splay: number;
  lengths: readonly [number, number, number];
  radii: readonly [number, number, number, number];
}

type Joints = readonly [number, number, number];

const anatomy = hand.fingers as unknown as Record<Exclude<Finger, "thumb">, Anatomy>;

/** The rotation of each joint in depth for a straight, half bent and bent finger, in degrees. */
const fingerJoints = hand.fingerJoints as unknown as readonly [Joints, Joints, Joints];

/** The positions of the thumb's two joints and tip for a straight, half bent and bent thumb. */
const thumbWay = hand.thumb.way as unknown as readonly (readonly [Point, Point, Point])[];
const thumbRoot = hand.thumb.root as unknown as Point;
const thumbRadii = hand.thumb.radii;

/** The outline of the palm down to the wrist. */
export const palm: readonly Point[] = rounded(hand.palm as unknown as Point[]);

/** The lines of the palm; those below a finger are omitted. */
export const palmLines: readonly (readonly Point[])[] = (hand.palmLines as unknown as Point[][]).map((line) => rounded(line));

/** Return the shape of all five fingers of a right hand, thumb first. */
export function shapeOf(bends: readonly Bend[]): FingerShape[] {
  return fingers.map((finger, index) => {
    const bend = Math.min(2, Math.max(0, bends[index] ?? 0));
    return finger === "thumb" ? thumb(bend) : longFinger(finger, bend);
  });
}

/** The smallest box to fit: a fist that fills the drawing would have a palm as large as a whole hand. */
const MIN_FRAME_HEIGHT = 248;

/** Return the part of `box` that a right hand with `bends` fills, with a margin for its lines. */
export function frameOf(bends: readonly Bend[], margin = 8): { x: number; y: number; width: number; height: number } {
  const ends = shapeOf(bends).flatMap(({ phalanges }) =>
    phalanges.flatMap(({ from, to, fromRadius, toRadius }) => [[...from, fromRadius], [...to, toRadius]]),
  );
  const all = [...ends, ...palm.map((point) => [...point, 0])] as [number, number, number][];
  const x = Math.min(...all.map(([at, , radius]) => at - radius)) - margin;
  const y = Math.min(...all.map(([, at, radius]) => at - radius)) - margin;
  const right = Math.max(...all.map(([at, , radius]) => at + radius)) + margin;
  const bottom = Math.max(...all.map(([, at, radius]) => at + radius)) + margin;
  const top = Math.min(y, bottom - MIN_FRAME_HEIGHT);
  return { x, y: top, width: right - x, height: bottom - top };
}

/** Return the bends of five finger states; invalid states count as straight. */
export function bendsOf(states: string): Bend[] {
  return fingers.map((_, index) => ["0", "1", "2"].indexOf(states[index] ?? "0")).map((bend) => Math.max(0, bend));
}

/** Return a phalanx as a polygon, counter-clockwise on the screen, round at both ends. */
export function outline({ from, to, fromRadius, toRadius }: Phalanx, steps = 7): Point[] {
  const along = Math.atan2(to[1] - from[1], to[0] - from[0]);
  const points: Point[] = [];
  for (let step = 0; step <= steps; step++) {
    points.push(onCircle(to, toRadius, along + Math.PI / 2 - (Math.PI * step) / steps));
  }
  for (let step = 0; step <= steps; step++) {
    points.push(onCircle(from, fromRadius, along - Math.PI / 2 - (Math.PI * step) / steps));
  }
  return points;
}

/** Whether two convex polygons share any area: no line separates them (separating axis theorem). */
export function overlap(some: readonly Point[], others: readonly Point[]): boolean {
  return ![...normals(some), ...normals(others)].some((normal) => {
    const [least, most] = extent(some, normal);
    const [otherLeast, otherMost] = extent(others, normal);
    return most <= otherLeast || otherMost <= least;
  });
}

function longFinger(finger: Exclude<Finger, "thumb">, bend: Bend): FingerShape {
  const { knuckle, splay, lengths, radii } = anatomy[finger];
  const turned = fingerJoints.map((joint) => along(joint, bend));
  const splayRad = rad(splay);
  const up: Point = [Math.sin(splayRad), -Math.cos(splayRad)];
  const points: Point[] = [knuckle];
  const folded: boolean[] = [];
  let angle = 0;
  lengths.forEach((length, index) => {
    angle += turned[index] ?? 0;
    const visible = length * Math.cos(rad(angle));
    const [x, y] = points[index] ?? knuckle;
    points.push([x + up[0] * visible, y + up[1] * visible]);
    folded.push(angle > 75);
  });
  const phalanges = chain(points, radii, folded);
  return { finger, phalanges, nail: angle > 90 ? nailOf(phalanges[2], angle) : null, creases: creasesOf(phalanges) };
}

function thumb(bend: Bend): FingerShape {
  const index = bend <= 1 ? 0 : 1;
  const before = thumbWay[index] ?? [thumbRoot, thumbRoot, thumbRoot];
  const after = thumbWay[index + 1] ?? before;
  const joints = before.map((point, joint) => between(point, after[joint] ?? point, bend - index));
  const phalanges = chain([thumbRoot, ...joints], thumbRadii, [false, bend > 1.4, bend > 1.4]);
  const [, , tip] = phalanges;
  return {
    finger: "thumb",
    phalanges,
    nail: bend > 1.4 ? nailOf(tip, 130) : null,
    creases: creasesOf(phalanges),
  };
}

function chain(points: readonly Point[], radii: readonly number[], folded: readonly boolean[]): FingerShape["phalanges"] {
  const phalanx = (index: 0 | 1 | 2): Phalanx => ({
    from: points[index] ?? [0, 0],
    to: points[index + 1] ?? [0, 0],
    fromRadius: radii[index] ?? 0,
    toRadius: radii[index + 1] ?? 0,
    folded: folded[index] ?? false,
  });
  return [phalanx(0), phalanx(1), phalanx(2)];
}

/** The nail on the back of the tip; `angle` is the rotation of the tip into view. */
function nailOf({ from, to, toRadius }: Phalanx, angle: number): Point[] {
  const way = Math.atan2(to[1] - from[1], to[0] - from[0]);
  const long = toRadius * Math.min(1, Math.sin(rad(Math.min(angle, 180) - 90)) + 0.35) * 0.72;
  const wide = toRadius * 0.62;
  return Array.from({ length: 14 }, (_, step) => {
    const turn = (2 * Math.PI * step) / 14;
    const [u, v] = [long * Math.cos(turn) + toRadius * 0.08, wide * Math.sin(turn)];
    return [to[0] + u * Math.cos(way) - v * Math.sin(way), to[1] + u * Math.sin(way) + v * Math.cos(way)];
  });
}

/** A line across each of the two outer joints; a joint that is seen end on has none. */
function creasesOf(phalanges: FingerShape["phalanges"]): [Point, Point][] {
  return phalanges.slice(1).flatMap((phalanx): [Point, Point][] => {
    const [dx, dy] = [phalanx.to[0] - phalanx.from[0], phalanx.to[1] - phalanx.from[1]];
    const length = Math.hypot(dx, dy);
    if (length < 10) return [];
    const half = phalanx.fromRadius * 0.55;
    const [nx, ny] = [(-dy / length) * half, (dx / length) * half];
    const [x, y] = phalanx.from;
    return [[[x + nx, y + ny], [x - nx, y - ny]]];
  });
}

/** Return a smooth line through `points` (Catmull-Rom). */
function rounded(points: readonly Point[], steps = 4): Point[] {
  const at = (index: number): Point => points[Math.min(points.length - 1, Math.max(0, index))] ?? [0, 0];
  return points.flatMap((point, index) =>
    index === points.length - 1
      ? [point]
      : Array.from({ length: steps }, (_, step): Point => {
          const part = step / steps;
          const on = (axis: 0 | 1) => {
            const [a, b, c, d] = [at(index - 1)[axis], at(index)[axis], at(index + 1)[axis], at(index + 2)[axis]];
            return b + 0.5 * part * (c - a + part * (2 * a - 5 * b + 4 * c - d + part * (3 * (b - c) + d - a)));
          };
          return [on(0), on(1)];
        }),
  );
}

function along(stops: readonly [number, number, number], bend: Bend): number {
  return bend <= 1 ? stops[0] + (stops[1] - stops[0]) * bend : stops[1] + (stops[2] - stops[1]) * (bend - 1);
}

function between(from: Point, to: Point, part: number): Point {
  return [from[0] + (to[0] - from[0]) * part, from[1] + (to[1] - from[1]) * part];
}

function onCircle([x, y]: Point, radius: number, angle: number): Point {
  return [x + radius * Math.cos(angle), y + radius * Math.sin(angle)];
}

function normals(polygon: readonly Point[]): Point[] {
  return polygon.map(([x, y], index) => {
    const [nextX, nextY] = polygon[(index + 1) % polygon.length] ?? [x, y];
    return [nextY - y, x - nextX];
  });
}

function extent(polygon: readonly Point[], [nx, ny]: Point): [number, number] {
  const places = polygon.map(([x, y]) => x * nx + y * ny);
  return [Math.min(...places), Math.max(...places)];
}

function rad(degrees: number): number {
  return (degrees * Math.PI) / 180;
}
