/** What surrounds the person in virtual reality: ground, light, robot, ball, marks of targets, hands, panel. */
import {
  Color, DirectionalLight, GridHelper, Group, HemisphereLight, Mesh, MeshBasicMaterial, MeshStandardMaterial, PlaneGeometry, Quaternion, Raycaster,
  RingGeometry, Scene, SphereGeometry, Vector2, Vector3, BufferGeometry, Line, LineBasicMaterial, Plane, DoubleSide, type Intersection,
} from "three";
import { castShadows } from "~/robot3d/light";
import { release } from "~/robot3d/urdf";
import { BALL_RADIUS_M } from "../figure";
import type { Footprint, HumanoidModel, Place, Side } from "../humanoid";
import { Body } from "./body";
import { toScene, type Vector } from "./frames";
import { TrackedHand } from "./hands";
import { Panel } from "./panel";

const COLOURS = { sky: "#dfe6ee", ground: "#c3cbd6", line: "#a7b1bf", ball: "#e8590c", target: "#2563c9", ray: "#2563c9", outside: "#ffb020" };
/** Until a session says it. */
export const DEFAULT_REACH_M = 0.12;
const PANEL_AT = new Vector3(-0.9, 1.45, 0);
const RAY_M = 3;

export class Room {
  readonly scene = new Scene();
  readonly body: Body;
  readonly panel = new Panel();
  readonly hands: Record<Side, TrackedHand> = { left: new TrackedHand("left", DEFAULT_REACH_M), right: new TrackedHand("right", DEFAULT_REACH_M) };
  /** The ground of the robot, which may move under the scene. */
  readonly #ground = new Group();
  readonly #plate = new Mesh(new PlaneGeometry(12, 12), new MeshStandardMaterial({ color: COLOURS.ground, roughness: 1 }));
  readonly #grid = new GridHelper(12, 24, COLOURS.line, COLOURS.line);
  readonly #ball = new Mesh(new SphereGeometry(BALL_RADIUS_M, 24, 16), new MeshStandardMaterial({ color: COLOURS.ball, roughness: 0.5 }));
  readonly #target = new Mesh(new RingGeometry(0.04, 0.055, 40), new MeshBasicMaterial({ color: COLOURS.target, side: DoubleSide }));
  readonly #chosen = new Mesh(new RingGeometry(0.06, 0.075, 40), new MeshBasicMaterial({ color: COLOURS.target, side: DoubleSide, transparent: true, opacity: 0.8 }));
  readonly #rays: Record<Side, Line<BufferGeometry, LineBasicMaterial>> = { left: ray(), right: ray() };
  readonly #caster = new Raycaster();
  readonly #plane = new Plane(new Vector3(0, 1, 0), 0);
  readonly #found: Intersection[] = [];
  readonly #place = new Vector3();
  readonly #sun = new DirectionalLight("#ffffff", 2);

  /** Throws `InvalidDescription` for a URDF that cannot be drawn. */
  constructor(urdf: string, model: HumanoidModel) {
    this.body = new Body(urdf, model);
    this.scene.background = new Color(COLOURS.sky);
    this.#ground.rotation.x = -Math.PI / 2;
    this.#ground.add(this.body.root);
    this.#plate.rotation.x = -Math.PI / 2;
    this.#plate.position.y = -0.002;
    this.#plate.receiveShadow = true;
    this.#target.rotation.x = this.#chosen.rotation.x = -Math.PI / 2;
    this.#ball.castShadow = true;
    this.#sun.position.set(0.8, 2.5, 1.2);
    castShadows(this.#sun, 1.5, 0.5, 6);
    this.panel.mesh.position.copy(PANEL_AT);
    this.panel.mesh.rotation.y = Math.PI / 2;
    this.scene.add(
      this.#ground, this.#plate, this.#grid, this.#ball, this.#target, this.#chosen, this.panel.mesh, this.hands.left.root, this.hands.right.root,
      this.#rays.left, this.#rays.right, this.#sun, new HemisphereLight("#ffffff", "#8090a8", 1.4),
    );
    this.#ball.visible = this.#target.visible = this.#chosen.visible = false;
  }

  /** Put the anchor of the ground of the robot into the middle of the scene. */
  anchorAt([x, y, yaw]: Footprint): void {
    // the ground has z up: its group turns by -yaw about the vertical after the quarter turn
    this.#ground.rotation.set(-Math.PI / 2, 0, -yaw);
    this.#ground.position.set(-(Math.cos(yaw) * x + Math.sin(yaw) * y), 0, Math.cos(yaw) * y - Math.sin(yaw) * x);
  }

  /** Show the ball at a place on the ground of the robot; null hides it. */
  showBall(anchor: Footprint, place: Readonly<Vector> | null): void {
    this.#ball.visible = place !== null;
    if (place !== null) toScene(anchor, place.x, place.y, place.z, this.#ball.position);
  }

  /** Where the ball is in the scene; null while it is hidden. */
  get ball(): Vector3 | null {
    return this.#ball.visible ? this.#ball.position : null;
  }

  showTarget(anchor: Footprint, target: Place | null): void {
    this.#target.visible = target !== null;
    if (target !== null) toScene(anchor, target[0], target[1], Math.max(target[2], 0.005), this.#target.position);
  }

  /** Show the place in the scene that a therapist aims at. */
  showChosen(place: Vector3 | null): void {
    this.#chosen.visible = place !== null;
    if (place !== null) this.#chosen.position.copy(place);
  }

  showOutside(isOutside: boolean): void {
    this.#plate.material.color.set(isOutside ? COLOURS.outside : COLOURS.ground);
  }

  /** The button of the panel that a ray hits, which is drawn as aimed at. */
  aimAtPanel(from: Vector3, turn: Quaternion): string | null {
    this.#aim(from, turn);
    this.#found.length = 0;
    const [hit] = this.#caster.intersectObject(this.panel.mesh, false, this.#found);
    if (hit?.uv === undefined) {
      this.panel.leave();
      return null;
    }
    return this.panel.aim(hit.uv.x, hit.uv.y);
  }

  /** Where a ray meets the horizontal plane at a height; null if it does not within the room. */
  aimAtHeight(from: Vector3, turn: Quaternion, heightM: number): Vector3 | null {
    this.#aim(from, turn);
    this.#plane.constant = -heightM;
    const hit = this.#caster.ray.intersectPlane(this.#plane, this.#place);
    return hit === null || hit.distanceTo(from) > 2 * RAY_M ? null : hit;
  }

  /** A ray through a point of the picture, for a pointer. */
  castFrom(point: Vector2, camera: Parameters<Raycaster["setFromCamera"]>[1], from: Vector3, turn: Quaternion): void {
    this.#caster.setFromCamera(point, camera);
    from.copy(this.#caster.ray.origin);
    turn.setFromUnitVectors(FORWARD, this.#caster.ray.direction);
  }

  showRay(side: Side, hand: TrackedHand, isShown: boolean): void {
    const line = this.#rays[side];
    line.visible = isShown && hand.hasRay;
    if (!line.visible) return;
    line.position.copy(hand.rayFrom);
    line.quaternion.copy(hand.rayTurn);
  }

  dispose(): void {
    this.body.dispose();
    this.panel.dispose();
    for (const hand of Object.values(this.hands)) hand.dispose();
    for (const line of Object.values(this.#rays)) {
      line.geometry.dispose();
      line.material.dispose();
    }
    this.#grid.dispose();
    this.#sun.dispose();
    release(this.scene);
  }

  #aim(from: Vector3, turn: Quaternion): void {
    this.#caster.ray.origin.copy(from);
    this.#caster.ray.direction.copy(FORWARD).applyQuaternion(turn);
  }
}

const FORWARD = new Vector3(0, 0, -1);

function ray(): Line<BufferGeometry, LineBasicMaterial> {
  const line = new Line(new BufferGeometry().setFromPoints([new Vector3(), new Vector3(0, 0, -RAY_M)]), new LineBasicMaterial({ color: COLOURS.ray }));
  line.visible = false;
  return line;
}
