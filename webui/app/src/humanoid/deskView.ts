/** The 3D view of the desk page: it follows the robot and the person who exercises, and picks places where balls are to land. */
import { Mesh, MeshStandardMaterial, Plane, PlaneGeometry, Raycaster, Vector2, Vector3 } from "three";
import { castShadows } from "~/robot3d/light";
import { OrbitView } from "~/robot3d/orbitView";
import { HumanoidFigure, type FigureColours } from "./figure";
import { onGround, type HumanoidModel, type LiveDocument, type Place } from "./humanoid";

const DISTANCES = { least: 0.5, most: 8 };
const GRID_M = 20;
/** Farther than the camera sees, so that the horizon is straight. */
const GROUND_M = 100;
/** From the middle of what is shown to the camera: of the robot alone, and of the robot with a person in front of it. */
const START = new Vector3(1.9, -1.9, 0.75);
const START_WITH_PERSON = new Vector3(0.9, -3.3, 0.9);
const MIDDLE_M = 0.45;
/** A person sits so far in front of the robot, where the headset does not say it. */
const PERSON_MIDDLE = { share: 0.5, upM: 0.65 };
/** A press that moves farther turns the view. */
const CLICK_PX = 5;
const FOLLOWS_M = 0.002;
/** A person who is away for longer is gone; a late pose must not move the camera. */
const GONE_MS = 3000;
/** Below this ratio of width to height the camera moves back. */
const FITS_AT_ASPECT = 1.4;

export interface DeskColours extends FigureColours {
  background: string;
  ground: string;
  line: string;
}

export class DeskView {
  readonly figure: HumanoidFigure;
  readonly #view: OrbitView;
  readonly #ground = new Mesh(new PlaneGeometry(GROUND_M, GROUND_M), new MeshStandardMaterial({ roughness: 1 }));
  readonly #middle = new Vector3(0, 0, MIDDLE_M);
  readonly #wanted = new Vector3();
  #live: LiveDocument | null = null;
  #shown: LiveDocument | null = null;
  #pressedAt: Vector2 | null = null;
  #personMs = -Infinity;
  #showsPerson = false;
  /** The view shows all until a user turns it. */
  #isTurned = false;
  /** Where a person pressed, on the horizontal plane at `pickHeightM`; null ignores presses. */
  onPick: ((place: Place) => void) | null = null;
  pickHeightM = 0;
  /** Where the next ball is to land, in the frame of the feet; null shows nothing. */
  target: Place | null = null;

  /** Throws where the browser has no WebGL, or for a URDF that cannot be drawn. */
  constructor(host: HTMLElement, urdf: string, model: HumanoidModel, colours: DeskColours) {
    this.#view = new OrbitView(host, Math.PI / 2 - 0.02, {
      onFrame: () => this.#pose(),
      onFit: () => !this.#isTurned && this.reset(),
    });
    this.#view.distances = DISTANCES;
    try {
      this.figure = new HumanoidFigure(urdf, model, colours);
    } catch (error) {
      this.#view.dispose();
      throw error;
    }
    this.#ground.receiveShadow = true;
    this.#ground.position.z = -0.001;
    this.#view.scene.add(this.figure.root, this.#ground);
    this.#view.sun.position.set(-1.2, -1.8, 3);
    castShadows(this.#view.sun, 1.8, 0.5, 8);
    this.#view.controls.addEventListener("start", () => (this.#isTurned = true));
    this.#view.canvas.addEventListener("pointerdown", this.#pressed);
    this.#view.canvas.addEventListener("pointerup", this.#released);
    this.recolour(colours);
    this.reset();
  }

  /** Show a document with the next frame; the camera follows the robot. */
  show(live: LiveDocument): void {
    this.#live = live;
    this.#view.draw();
  }

  recolour(colours: DeskColours): void {
    this.#ground.material.color.set(colours.ground);
    this.figure.recolour(colours);
    this.#view.recolour(colours.background, colours.line, GRID_M, 0);
  }

  /** Handle a key; returns whether it had an effect. */
  key(key: string): boolean {
    const done = this.#view.key(key);
    if (done === "reset") this.reset();
    else if (done) this.#isTurned = true;
    return done !== false;
  }

  reset(): void {
    const { controls, camera, drawNow } = this.#view;
    this.#isTurned = false;
    controls.target.copy(this.#middle);
    const back = Math.max(1, FITS_AT_ASPECT / camera.aspect);
    camera.position.copy(this.#showsPerson ? START_WITH_PERSON : START).multiplyScalar(back).add(controls.target);
    controls.update();
    drawNow();
  }

  dispose(): void {
    this.figure.dispose();
    this.#ground.geometry.dispose();
    this.#ground.material.dispose();
    this.#view.dispose();
  }

  /** The place on the plane of picking below a point of the screen; null above the horizon. */
  placeAt(clientX: number, clientY: number): Place | null {
    const box = this.#view.canvas.getBoundingClientRect();
    const at = new Vector2((2 * (clientX - box.left)) / box.width - 1, 1 - (2 * (clientY - box.top)) / box.height);
    const ray = new Raycaster();
    ray.setFromCamera(at, this.#view.camera);
    return ray.ray.intersectPlane(new Plane(new Vector3(0, 0, 1), -this.pickHeightM), new Vector3())?.toArray() ?? null;
  }

  readonly #pressed = ({ clientX, clientY, button }: PointerEvent): void => {
    this.#pressedAt = button === 0 ? new Vector2(clientX, clientY) : null;
  };

  readonly #released = ({ clientX, clientY }: PointerEvent): void => {
    const from = this.#pressedAt;
    this.#pressedAt = null;
    if (this.onPick === null || from === null || from.distanceTo(new Vector2(clientX, clientY)) > CLICK_PX) return;
    const place = this.placeAt(clientX, clientY);
    if (place !== null) this.onPick(place);
  };

  /** Move all to the newest document; no frame follows before the next one. */
  #pose(): boolean {
    const live = this.#live;
    if (live === null || live === this.#shown) return false;
    this.#shown = live;
    this.figure.show(live);
    this.figure.preview(this.target === null || live.stance === null ? null : onGround(live.stance, this.target));
    this.#follow(live);
    return false;
  }

  /** Keep the robot, and a person in front of it, in the middle; a person who comes or goes changes the initial view only. */
  #follow({ base, patient }: LiveDocument): void {
    const [x, y] = base ?? [];
    if (x === undefined || y === undefined) return;
    const now = performance.now();
    const person = patient?.headset?.position ?? null;
    if (person !== null) this.#personMs = now;
    const showsPerson = now - this.#personMs < GONE_MS;
    const isOther = showsPerson !== this.#showsPerson;
    this.#showsPerson = showsPerson;
    if (person !== null) this.#wanted.set(x + PERSON_MIDDLE.share * (person[0] - x), y + PERSON_MIDDLE.share * (person[1] - y), PERSON_MIDDLE.upM);
    else if (!showsPerson) this.#wanted.set(x, y, MIDDLE_M);
    const { controls, camera, sun } = this.#view;
    if (this.#wanted.distanceTo(this.#middle) < FOLLOWS_M && !isOther) return;
    const moved = this.#wanted.clone().sub(this.#middle);
    this.#middle.copy(this.#wanted);
    sun.position.set(this.#middle.x - 1.2, this.#middle.y - 1.8, 3);
    sun.target.position.set(this.#middle.x, this.#middle.y, MIDDLE_M);
    if (isOther && !this.#isTurned) {
      this.reset();
      return;
    }
    controls.target.add(moved);
    camera.position.add(moved);
    controls.update();
  }
}
