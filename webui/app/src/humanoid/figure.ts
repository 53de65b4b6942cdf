/**
 * The humanoid with what is known of it, as one three.js group in metres with z up: body, centre of mass, ZMP, support
 * polygon, footsteps, forces, ball, and the person who exercises. The desk page and virtual reality show the same.
 */
import {
  ArrowHelper, BufferAttribute, BufferGeometry, CircleGeometry, Color, DoubleSide, Group, Line, LineBasicMaterial, LineLoop, Mesh, MeshBasicMaterial,
  MeshStandardMaterial, type Object3D, RingGeometry, SphereGeometry, Vector3,
} from "three";
import type { URDFRobot } from "urdf-loader";
import { parsed, release } from "~/robot3d/urdf";
import { shownBall, SIDES, soleAt, supportPolygon, type HumanoidModel, type LiveDocument, type Pair, type PatientState, type Place, type Side } from "./humanoid";

export const BALL_RADIUS_M = 0.025;
/** Above the ground, so that flat things do not flicker in it; a drawing order of millimetres. */
const LIFTED_M = { polygon: 0.002, steps: 0.003, landings: 0.004, points: 0.005 };
/** The length of the arrow of a force. */
const M_PER_N = 1 / 500;
const MAX_FOOTSTEPS = 24;
/** The length of the line that shows where a person looks. */
const GAZE_M = 0.45;
/** A foot that steps moves farther than the estimate drifts. */
const MOVED_M = 0.02;
/** A foot with this share of the weight stands. */
const STANDS = 0.2;

/** The colours of what is drawn beside the body. */
export interface FigureColours {
  com: string;
  zmp: string;
  polygon: string;
  steps: string;
  landings: Readonly<Record<Side, string>>;
  force: string;
  ball: string;
  target: string;
  person: string;
}

export class HumanoidFigure {
  /** Everything; add it to a scene whose z is up. */
  readonly root = new Group();
  /** All but the body, the ball and the person, which a patient is not to see. */
  readonly overlays = new Group();
  readonly person = new Group();
  readonly #robot: URDFRobot;
  readonly #model: HumanoidModel;
  readonly #com: Group;
  readonly #plumb = new Line(new BufferGeometry(), new LineBasicMaterial());
  readonly #zmp: Mesh;
  readonly #zmpReference: Mesh;
  readonly #polygon = new LineLoop(new BufferGeometry(), new LineBasicMaterial());
  readonly #area = new Mesh(new BufferGeometry(), flat(0.25));
  readonly #steps = new Group();
  readonly #landings: Record<Side, Outline> = { left: outline(), right: outline() };
  readonly #feet: Record<Side, ArrowHelper>;
  readonly #hands: Record<Side, ArrowHelper>;
  readonly #ball = new Mesh(new SphereGeometry(BALL_RADIUS_M, 24, 16), new MeshStandardMaterial({ roughness: 0.5 }));
  readonly #target: Mesh;
  readonly #landed: Mesh;
  readonly #preview: Mesh;
  readonly #head: Head;
  readonly #palms: Record<Side, Mesh>;
  readonly #stepMaterial = new LineBasicMaterial();
  readonly #last: Partial<Record<Side, readonly Pair[]>> = {};

  /** Throws `InvalidDescription` for a URDF that cannot be drawn. */
  constructor(urdf: string, model: HumanoidModel, colours: FigureColours) {
    this.#model = model;
    this.#robot = parsed(urdf);
    this.#robot.visible = false; // where it is, and how its joints stand, is known with the first state
    this.#com = marker(0.018);
    this.#zmp = new Mesh(new CircleGeometry(0.012, 24), flat(1));
    this.#zmpReference = new Mesh(new RingGeometry(0.014, 0.018, 24), flat(1));
    this.#target = new Mesh(new RingGeometry(0.04, 0.055, 32), flat(1));
    this.#preview = new Mesh(new RingGeometry(0.05, 0.06, 32), flat(0.7));
    this.#landed = new Mesh(new RingGeometry(0, 0.02, 4), flat(1));
    this.#feet = { left: arrow(), right: arrow() };
    this.#hands = { left: arrow(), right: arrow() };
    this.#head = headOf();
    this.#palms = { left: palm(), right: palm() };
    this.overlays.add(this.#com, this.#plumb, this.#zmp, this.#zmpReference, this.#area, this.#polygon, this.#steps, this.#target, this.#landed, this.#preview);
    for (const side of SIDES) this.overlays.add(this.#feet[side], this.#hands[side], this.#landings[side].edge, this.#landings[side].area);
    this.person.add(this.#head.root, this.#palms.left, this.#palms.right);
    this.#ball.castShadow = true;
    this.root.add(this.#robot, this.overlays, this.#ball, this.person);
    for (const part of [...this.overlays.children, this.#ball, ...this.person.children]) part.visible = false;
    this.recolour(colours);
  }

  /** The link of the robot by its name, where a view may look at. */
  link(name: string): Object3D | undefined {
    return this.#robot.links[name];
  }

  recolour(colours: FigureColours): void {
    paint(this.#com, colours.com);
    paint(this.#plumb, colours.com);
    paint(this.#zmp, colours.zmp);
    paint(this.#zmpReference, colours.zmp);
    paint(this.#area, colours.polygon);
    paint(this.#polygon, colours.polygon);
    this.#stepMaterial.color.set(colours.steps);
    for (const side of SIDES) {
      for (const force of [this.#feet[side], this.#hands[side]]) force.setColor(new Color(colours.force));
      paint(this.#palms[side], colours.person);
      paint(this.#landings[side].edge, colours.landings[side]);
      paint(this.#landings[side].area, colours.landings[side]);
    }
    paint(this.#ball, colours.ball);
    paint(this.#target, colours.target);
    paint(this.#landed, colours.ball);
    paint(this.#preview, colours.target);
    paint(this.#head.skull, colours.person);
    paint(this.#head.visor, colours.steps);
    paint(this.#head.gaze, colours.target);
  }

  /** Show a document; what it does not know is hidden. */
  show(document: LiveDocument): void {
    this.#pose(document);
    this.#balance(document);
    for (const side of SIDES) {
      this.#foot(side, document);
      this.#landing(side, document);
    }
    this.#hand(document);
    this.#throwing(document);
    this.#patient(document.patient ?? null);
  }

  /** Show where the next ball is to land, on the ground; null shows nothing. */
  preview(at: Place | null): void {
    place(this.#preview, at);
  }

  dispose(): void {
    release(this.root);
    this.#stepMaterial.dispose();
  }

  #pose({ base, joints }: LiveDocument): void {
    if (base?.length === 7) {
      const [x = 0, y = 0, z = 0, qx = 0, qy = 0, qz = 0, qw = 1] = base;
      this.#robot.position.set(x, y, z);
      this.#robot.quaternion.set(qx, qy, qz, qw);
      this.#robot.visible = true;
    }
    this.#model.joints.forEach((name, index) => {
      const angle = joints[index];
      if (angle != null && name in this.#robot.joints) this.#robot.setJointValue(name, angle);
    });
    this.#robot.updateMatrixWorld(true);
  }

  #balance(document: LiveDocument): void {
    const { com, zmp, zmpReference, base } = document;
    place(this.#com, com, LIFTED_M.points);
    this.#plumb.visible = com !== null;
    if (com !== null) draw(this.#plumb, [[...com, 0], [...com, base?.[2] ?? 0.5]]);
    place(this.#zmp, zmp, LIFTED_M.points);
    place(this.#zmpReference, zmpReference, LIFTED_M.points);
    const polygon = base === null ? [] : supportPolygon(document, { left: this.#sole("left"), right: this.#sole("right") });
    this.#polygon.visible = this.#area.visible = polygon.length > 2;
    if (polygon.length > 2) {
      draw(this.#polygon, polygon.map(([x, y]) => [x, y, LIFTED_M.polygon]));
      fill(this.#area, polygon, LIFTED_M.polygon);
    }
  }

  #foot(side: Side, { feet }: LiveDocument): void {
    const { force, pressure, share } = feet[side];
    point(this.#feet[side], force, pressure === null ? null : [...pressure, 0]);
    const corners = this.#sole(side);
    if ((share ?? 0) < STANDS || corners.length < 3) return;
    const stands = corners.map(([x, y]) => [x, y] as const);
    const before = this.#last[side];
    if (before?.every(([x, y], index) => Math.hypot(x - (stands[index]?.[0] ?? x), y - (stands[index]?.[1] ?? y)) < MOVED_M) === true) return;
    this.#last[side] = stands;
    const print = new LineLoop(new BufferGeometry(), this.#stepMaterial);
    draw(print, stands.map(([x, y]) => [x, y, LIFTED_M.steps]));
    this.#steps.visible = true;
    this.#steps.add(print);
    const oldest = this.#steps.children[0];
    if (this.#steps.children.length > MAX_FOOTSTEPS && oldest instanceof LineLoop) {
      oldest.removeFromParent();
      (oldest.geometry as BufferGeometry).dispose();
    }
  }

  /** Where a foot lands next: the outline of its sole. */
  #landing(side: Side, { feet }: LiveDocument): void {
    const { edge, area } = this.#landings[side];
    const landing = feet[side].landing ?? null;
    const corners = this.#contact(side)?.corners ?? [];
    edge.visible = area.visible = landing !== null && corners.length > 2;
    if (landing === null || !edge.visible) return;
    const sole = soleAt(landing, corners);
    draw(edge, sole.map(([x, y]) => [x, y, LIFTED_M.landings]));
    fill(area, sole, LIFTED_M.landings);
  }

  #hand({ hands }: LiveDocument): void {
    for (const side of SIDES) {
      const grip = this.#model.hands[`${side}_hand`];
      const link = grip === undefined ? undefined : this.#robot.links[grip.link];
      const at = link === undefined || grip === undefined ? null : this.root.worldToLocal(link.localToWorld(new Vector3(...grip.point))).toArray();
      point(this.#hands[side], hands[side].force, at);
    }
  }

  #throwing(live: LiveDocument): void {
    const ball = shownBall(live);
    place(this.#ball, ball?.position ?? null);
    place(this.#target, ball?.target ?? null);
    const landing = ball?.landing ?? null;
    place(this.#landed, landing === null ? null : [landing[0], landing[1], Math.max(landing[2], LIFTED_M.points)]);
  }

  #patient(patient: PatientState | null): void {
    const headset = patient?.headset ?? null;
    place(this.#head.root, headset?.position ?? null);
    if (headset !== null) this.#head.root.quaternion.set(...headset.rotation);
    for (const side of SIDES) {
      const hand = patient?.hands[side] ?? null;
      place(this.#palms[side], hand?.position ?? null);
      if (hand === null) continue;
      this.#palms[side].quaternion.set(...hand.rotation);
      this.#palms[side].scale.setScalar(1 - 0.35 * hand.grip);
    }
  }

  #contact(side: Side): HumanoidModel["contacts"][number] | undefined {
    return this.#model.contacts.find(({ name }) => name.startsWith(side));
  }

  /** The corners of a sole on the ground, where the body has it. */
  #sole(side: Side): Pair[] {
    const contact = this.#contact(side);
    const link = contact === undefined ? undefined : this.#robot.links[contact.link];
    if (contact === undefined || link === undefined) return [];
    return contact.corners.map((corner) => {
      const { x, y } = this.root.worldToLocal(link.localToWorld(new Vector3(...corner)));
      return [x, y] as const;
    });
  }
}

function flat(opacity: number): MeshBasicMaterial {
  return new MeshBasicMaterial({ transparent: opacity < 1, opacity, side: DoubleSide, depthWrite: opacity >= 1 });
}

/** The mark of a centre of mass on the ground: a disc in a ring. */
function marker(radius: number): Group {
  const mark = new Group();
  mark.add(new Mesh(new CircleGeometry(0.5 * radius, 24), flat(1)), new Mesh(new RingGeometry(0.8 * radius, radius, 24), flat(1)));
  return mark;
}

interface Outline {
  edge: LineLoop;
  area: Mesh;
}

function outline(): Outline {
  return { edge: new LineLoop(new BufferGeometry(), new LineBasicMaterial()), area: new Mesh(new BufferGeometry(), flat(0.35)) };
}

function arrow(): ArrowHelper {
  return new ArrowHelper(new Vector3(0, 0, 1), new Vector3(), 0.1);
}

interface Head {
  root: Group;
  skull: Mesh;
  visor: Mesh;
  gaze: Line;
}

/** A head with a headset and the line of where it looks: along its x axis with its z axis up, as the robot does. */
function headOf(): Head {
  const root = new Group();
  const skull = new Mesh(new SphereGeometry(0.1, 24, 16), new MeshStandardMaterial({ roughness: 0.8 }));
  skull.scale.set(1, 0.8, 1.2);
  const visor = new Mesh(new SphereGeometry(0.07, 16, 12), new MeshStandardMaterial({ roughness: 0.3 }));
  visor.scale.set(0.6, 1.1, 0.6);
  visor.position.set(0.08, 0, 0.02);
  const gaze = new Line(new BufferGeometry().setFromPoints([new Vector3(0.12, 0, 0.02), new Vector3(0.12 + GAZE_M, 0, 0.02)]), new LineBasicMaterial());
  root.add(skull, visor, gaze);
  return { root, skull, visor, gaze };
}

function palm(): Mesh {
  const shape = new Mesh(new SphereGeometry(0.05, 16, 12), new MeshStandardMaterial({ roughness: 0.8 }));
  shape.castShadow = true;
  return shape;
}

function paint(object: Object3D, colour: string): void {
  object.traverse((part) => {
    if (part instanceof Mesh || part instanceof Line) (part.material as MeshBasicMaterial | LineBasicMaterial).color.set(colour);
  });
}

function place(object: Object3D, at: Place | Pair | null, z = 0): void {
  object.visible = at !== null;
  if (at !== null) object.position.set(at[0], at[1], at[2] ?? z);
}

function point(shown: ArrowHelper, force: Place | null, at: Place | null): void {
  const size = force === null ? 0 : Math.hypot(...force);
  shown.visible = at !== null && size > 1;
  if (force === null || at === null || !shown.visible) return;
  shown.position.set(...at);
  shown.setDirection(new Vector3(...force).divideScalar(size));
  const length = size * M_PER_N;
  shown.setLength(length, Math.min(0.25 * length, 0.05), Math.min(0.15 * length, 0.03));
}

function draw(line: Line, points: readonly Place[]): void {
  line.geometry.setFromPoints(points.map((each) => new Vector3(...each)));
  line.geometry.computeBoundingSphere();
}

/** Fill a convex polygon on the ground by triangles from its first corner. */
function fill(mesh: Mesh, polygon: readonly Pair[], heightM: number): void {
  const corners = polygon.slice(1, -1).flatMap((corner, index) => [polygon[0], corner, polygon[index + 2]] as Pair[]);
  const places = new Float32Array(corners.flatMap(([x, y]) => [x, y, heightM]));
  mesh.geometry.dispose();
  mesh.geometry = new BufferGeometry();
  mesh.geometry.setAttribute("position", new BufferAttribute(places, 3));
}
