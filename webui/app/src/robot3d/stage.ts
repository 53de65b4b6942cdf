/** The 3D view of the robot in its cell. */
import {
  Box3, BoxGeometry, type BufferGeometry, type ColorRepresentation, CylinderGeometry, EdgesGeometry, Group, LineBasicMaterial, LineSegments, Mesh,
  MeshStandardMaterial, Sphere, SphereGeometry, Vector3,
} from "three";
import type { URDFRobot } from "urdf-loader";
import type { RobotDescription } from "~/robot/description";
import { bend, boxesOf, grip, parsed, release } from "./urdf";
import { type CellScene, type Footprint, type Form, furnitureOf, PART_SIZE, type Piece, type PieceKind, type Triple } from "./furniture";
import { JointTrack } from "./joint_track";
import { castShadows } from "./light";
import { DISTANCES } from "./orbit";
import { OrbitView } from "./orbitView";

/** The direction from the middle of the cell to the camera. */
const DIRECTION = new Vector3(-1.75, -1.45, 0.98).normalize();
/** The bounding sphere of a cell is larger than its projection. */
const FILLED = 0.78;
/** The shift of the view's centre: from above, more of the table is below the middle. */
const LOWERED = 0.12;
/** Below this ratio of width to height the camera moves back. */
const FITS_AT_ASPECT = 1.3;
const GROUND_M = -0.051;
/** Edges of curved surfaces are not drawn. */
const EDGE_DEG = 30;
/** What surrounds the cell does not decide the view. */
const SURROUNDING: ReadonlySet<PieceKind> = new Set(["fence", "keepOut", "reducedSpeed", "people"]);

/** The colours of the page, read from its tokens. */
export interface Palette {
  ground: string;
  table: string;
  line: string;
  fixture: string;
  bin: string;
  part: string;
  truepart: string;
  obstacle: string;
  keepout: string;
  reduced: string;
  people: string;
}

/** How clearly a thing is drawn; what surrounds others is transparent. */
const OPACITY: Partial<Record<PieceKind, number>> = { bin: 0.45, fence: 0.3, keepOut: 0.18, reducedSpeed: 0.14, people: 0.18 };

/** Another robot of the cell. */
interface Neighbour {
  robot: URDFRobot;
  track: JointTrack;
  names: readonly string[];
}

export class Stage {
  readonly #view: OrbitView;
  readonly #furniture = new Group();
  readonly #track = new JointTrack();
  readonly #description: RobotDescription;
  readonly #robot: URDFRobot;
  readonly #robotBox: Box3;
  readonly #foot: Footprint;
  readonly #grippedPart: Mesh;
  readonly #neighbours = new Map<string, Neighbour>();
  readonly #neighbourBox = new Box3();
  #palette: Palette;
  #cell: CellScene | null = null;
  /** The view follows the size of the cell until a user turns it. */
  #isTurned = false;
  #names: readonly string[] = [];
  #gripper = "";

  /** Throws when the browser has no WebGL or the description cannot be drawn. */
  constructor(host: HTMLElement, description: RobotDescription, palette: Palette) {
    this.#description = description;
    const robot = (this.#robot = placed(description));
    const boxes = boxesOf(robot, description.joints.map((joint) => joint.name), description.home);
    this.#robotBox = boxes.robot;
    const { min, max } = boxes.root.isEmpty() ? new Box3(new Vector3(), new Vector3()) : boxes.root;
    this.#foot = [[min.x, min.y], [max.x, max.y]];
    this.#palette = palette;
    this.#view = new OrbitView(host, Math.PI / 2 + 0.08, { onFrame: (nowMs) => this.#bend(nowMs), onFit: () => !this.#isTurned && this.reset() });
    this.#view.controls.addEventListener("start", () => (this.#isTurned = true));

    this.#grippedPart = new Mesh(new BoxGeometry(...PART_SIZE), new MeshStandardMaterial());
    this.#grippedPart.visible = false;
    this.#grippedPart.castShadow = true;
    robot.links[description.tip]?.add(this.#grippedPart);
    this.#view.scene.add(robot, this.#furniture);
    this.#shine();
    this.restyle(palette);
  }

  /** Set the target positions of the joints; the arm is interpolated to them. */
  joints(names: readonly string[], positions: readonly number[]): void {
    this.#names = names;
    if (this.#track.push(positions, performance.now())) this.draw();
  }

  /** Show another robot of the cell. Throws when its description cannot be drawn. */
  neighbour(name: string, description: RobotDescription): void {
    const robot = placed(description);
    const { robot: box } = boxesOf(robot, description.joints.map((joint) => joint.name), description.home);
    this.#neighbourBox.union(box);
    this.#neighbours.set(name, { robot, track: new JointTrack(), names: [] });
    this.#view.scene.add(robot);
    if (!this.#isTurned) this.reset();
    this.draw();
  }

  /** Set the target positions of the joints of another robot. */
  neighbourJoints(name: string, names: readonly string[], positions: readonly number[]): void {
    const neighbour = this.#neighbours.get(name);
    if (neighbour === undefined) return;
    neighbour.names = names;
    if (neighbour.track.push(positions, performance.now())) this.draw();
  }

  gripper(closed: boolean, holds: boolean): void {
    const state = `${closed} ${holds}`;
    if (state === this.#gripper) return;
    this.#gripper = state;
    grip(this.#robot, this.#description.fingers, closed, holds);
    this.#grippedPart.visible = holds;
    this.draw();
  }

  /** Show the furniture of the cell. */
  furnish(cell: CellScene | null): void {
    this.#cell = cell;
    for (const piece of [...this.#furniture.children]) release(piece);
    for (const piece of furnitureOf(cell, this.#foot)) this.#furniture.add(this.#piece(piece));
    if (!this.#isTurned) this.reset();
    this.draw();
  }

  restyle(palette: Palette): void {
    this.#palette = palette;
    (this.#grippedPart.material as MeshStandardMaterial).color.set(palette.part);
    const size = Math.max(6, Math.ceil(4 * sphereOf(this.#robotBox).radius));
    this.#view.recolour(palette.ground, palette.line, size, GROUND_M);
    this.furnish(this.#cell);
  }

  /** Handle a key; returns whether it had an effect. */
  key(key: string): boolean {
    const done = this.#view.key(key);
    if (done === "reset") this.reset();
    else if (done) this.#isTurned = true;
    return done !== false;
  }

  /** Restore the initial view of the whole cell. */
  reset(): void {
    const { camera, controls } = this.#view;
    const { center, radius } = sphereOf(this.#extent());
    const back = Math.max(1, FITS_AT_ASPECT / camera.aspect);
    const distance = (FILLED * back * radius) / Math.sin((camera.fov * Math.PI) / 360);
    const distances = { least: Math.min(DISTANCES.least, distance / 3), most: Math.max(DISTANCES.most, 2 * distance) };
    this.#view.distances = distances;
    camera.far = 3 * distances.most;
    camera.updateProjectionMatrix();
    center.z -= LOWERED * radius;
    controls.target.copy(center);
    camera.position.copy(DIRECTION).multiplyScalar(distance).add(center);
    this.#isTurned = false;
    controls.update();
    this.#view.drawNow();
  }

  /** The box around the cell; zones and fences are not what a user looks at. */
  #extent(): Box3 {
    const box = this.#robotBox.clone().union(this.#neighbourBox);
    for (const piece of this.#furniture.children) if (piece.userData["isSurrounding"] !== true) box.expandByObject(piece);
    return box;
  }

  readonly draw = (): void => this.#view.draw();

  dispose(): void {
    for (const piece of [...this.#furniture.children]) release(piece);
    release(this.#robot);
    this.#view.dispose();
  }

  /** Move the joints to where they are now; returns whether one still moves. */
  #bend(nowMs: number): boolean {
    bend(this.#robot, this.#names, this.#track.at(nowMs));
    for (const { robot, names, track } of this.#neighbours.values()) bend(robot, names, track.at(nowMs));
    return [this.#track, ...[...this.#neighbours.values()].map(({ track }) => track)].some((track) => track.glides(nowMs));
  }

  /** Place the light above the robot; its shadows cover the reach of the arm. */
  #shine(): void {
    const { center, radius } = sphereOf(this.#robotBox);
    const reach = Math.max(1.6, 1.6 * radius);
    const { sun } = this.#view;
    sun.position.set(-0.75, -1.13, 1.88).multiplyScalar(reach).add(center);
    sun.target.position.copy(center);
    castShadows(sun, reach, 0.3 * reach, 3.8 * reach);
  }

  #piece({ kind, form, size, position, orientation }: Piece): Group {
    const geometry = geometryOf(form ?? "box", size);
    const opacity = OPACITY[kind] ?? 1;
    const see = opacity < 1;
    const material = new MeshStandardMaterial({
      color: this.#colour(kind), roughness: 0.85, transparent: see, opacity, depthWrite: !see,
    });
    const mesh = new Mesh(geometry, material);
    mesh.castShadow = kind === "part";
    mesh.receiveShadow = !see;
    const piece = new Group();
    piece.userData["isSurrounding"] = SURROUNDING.has(kind);
    piece.add(mesh, new LineSegments(new EdgesGeometry(geometry, EDGE_DEG), new LineBasicMaterial({ color: this.#palette.line })));
    piece.position.set(...position);
    piece.quaternion.set(...orientation);
    return piece;
  }

  #colour(kind: PieceKind): ColorRepresentation {
    const { table, fixture, bin, line, part, truepart, obstacle, keepout, reduced, people } = this.#palette;
    return {
      table, fixture, bin, nest: line, part, truePart: truepart, obstacle, fence: line, camera: obstacle,
      keepOut: keepout, reducedSpeed: reduced, people,
    }[kind];
  }
}

/** The robot of a description at its place in the cell. */
function placed({ urdf, base }: RobotDescription): URDFRobot {
  const robot = parsed(urdf);
  robot.position.set(...base.position);
  robot.quaternion.set(...base.orientation);
  return robot;
}

function geometryOf(form: Form, [x, y, z]: Triple): BufferGeometry {
  if (form === "sphere") return new SphereGeometry(x / 2, 24, 16);
  if (form === "cylinder") return new CylinderGeometry(x / 2, x / 2, z, 32).rotateX(Math.PI / 2);
  return new BoxGeometry(x, y, z);
}

function sphereOf(box: Box3): Sphere {
  return box.getBoundingSphere(new Sphere());
}
