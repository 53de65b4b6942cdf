/** The 3D view of the desk page: camera, light, ground, and picking of places where a ball is to land. */
import {
  DirectionalLight, type GridHelper, Mesh, MeshStandardMaterial, PerspectiveCamera, Plane, PlaneGeometry, Raycaster, Scene, Vector2,
  Vector3, WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { ambientLights, castShadows, groundGrid } from "~/robot3d/light";
import { stepOf, stepped } from "~/robot3d/orbit";
import { HumanoidFigure, type FigureColours } from "./figure";
import { onGround, type HumanoidModel, type LiveDocument, type Place } from "./humanoid";

const MAX_PIXEL_RATIO = 2;
const DISTANCES = { least: 0.5, most: 8 };
/** From the middle of the robot to the camera. */
const START = new Vector3(1.9, -1.9, 0.75);
const MIDDLE_M = 0.45;
/** A press that moves farther turns the view. */
const CLICK_PX = 5;
const FOLLOWS_M = 0.002;

export interface DeskColours extends FigureColours {
  background: string;
  ground: string;
  line: string;
}

export class DeskView {
  readonly figure: HumanoidFigure;
  readonly #host: HTMLElement;
  readonly #renderer: WebGLRenderer;
  readonly #scene = new Scene();
  readonly #camera = new PerspectiveCamera(38, 1, 0.05, 40);
  readonly #controls: OrbitControls;
  readonly #resized: ResizeObserver;
  readonly #seen: IntersectionObserver;
  readonly #ground = new Mesh(new PlaneGeometry(20, 20), new MeshStandardMaterial({ roughness: 1 }));
  readonly #sun = new DirectionalLight("#ffffff", 2.2);
  #grid: GridHelper | null = null;
  #frame = 0;
  #isInView = true;
  #pressedAt: Vector2 | null = null;
  /** Where a person pressed, on the horizontal plane at `pickHeightM`; null ignores presses. */
  onPick: ((place: Place) => void) | null = null;
  pickHeightM = 0;
  /** Where the next ball is to land, in the frame of the feet; null shows nothing. */
  target: Place | null = null;

  /** Throws where the browser has no WebGL, or for a URDF that cannot be drawn. */
  constructor(host: HTMLElement, urdf: string, model: HumanoidModel, colours: DeskColours) {
    this.#host = host;
    this.#renderer = new WebGLRenderer({ antialias: true, powerPreference: "low-power" });
    this.#renderer.setPixelRatio(Math.min(devicePixelRatio, MAX_PIXEL_RATIO));
    this.#renderer.shadowMap.enabled = true;
    this.#renderer.domElement.setAttribute("aria-hidden", "true");
    this.#renderer.domElement.style.touchAction = "pan-y";
    host.append(this.#renderer.domElement);
    this.figure = new HumanoidFigure(urdf, model, colours);
    this.#ground.receiveShadow = true;
    this.#ground.position.z = -0.001;
    this.#scene.add(this.figure.root, this.#ground, this.#sun, this.#sun.target, ...ambientLights());
    this.#sun.position.set(-1.2, -1.8, 3);
    castShadows(this.#sun, 1.5, 0.5, 8);
    this.#camera.up.set(0, 0, 1);
    this.#controls = new OrbitControls(this.#camera, this.#renderer.domElement);
    this.#controls.maxPolarAngle = Math.PI / 2 - 0.02;
    this.#controls.minDistance = DISTANCES.least;
    this.#controls.maxDistance = DISTANCES.most;
    this.#controls.enableZoom = false; // the wheel scrolls the page until the view is used
    this.#controls.addEventListener("change", this.draw);
    host.addEventListener("focusin", this.#taken);
    host.addEventListener("focusout", this.#left);
    this.#renderer.domElement.addEventListener("pointerdown", this.#pressed);
    this.#renderer.domElement.addEventListener("pointerup", this.#released);
    this.#resized = new ResizeObserver(() => this.#fit());
    this.#resized.observe(host);
    this.#seen = new IntersectionObserver(([entry]) => {
      this.#isInView = entry?.isIntersecting ?? true;
      this.draw();
    });
    this.#seen.observe(host);
    document.addEventListener("visibilitychange", this.draw);
    this.recolour(colours);
    this.reset();
  }

  /** Show a document; the camera follows the robot. */
  show(live: LiveDocument): void {
    this.figure.show(live);
    const { stance } = live;
    this.figure.preview(this.target === null || stance === null ? null : onGround(stance, this.target));
    const [x, y] = live.base ?? [];
    if (x !== undefined && y !== undefined) this.#follow(x, y);
    this.draw();
  }

  recolour(colours: DeskColours): void {
    this.#renderer.setClearColor(colours.background);
    this.#ground.material.color.set(colours.ground);
    this.#grid?.removeFromParent();
    this.#grid?.dispose();
    this.#grid = groundGrid(20, colours.line);
    this.#scene.add(this.#grid);
    this.figure.recolour(colours);
    this.draw();
  }

  /** Handle a key; returns whether it had an effect. */
  key(key: string): boolean {
    const step = stepOf(key);
    if (step === null) return false;
    if (step === "reset") this.reset();
    else {
      this.#camera.position.set(...stepped(this.#camera.position.toArray(), this.#controls.target.toArray(), step, DISTANCES));
      this.#controls.update();
    }
    this.draw();
    return true;
  }

  reset(): void {
    const { x, y } = this.#controls.target;
    this.#controls.target.set(x, y, MIDDLE_M);
    this.#camera.position.copy(START).add(this.#controls.target);
    this.#controls.update();
    this.draw();
  }

  readonly draw = (): void => {
    if (this.#frame !== 0 || document.hidden || !this.#isInView) return;
    this.#frame = requestAnimationFrame(() => {
      this.#frame = 0;
      this.#renderer.render(this.#scene, this.#camera);
    });
  };

  dispose(): void {
    cancelAnimationFrame(this.#frame);
    this.#frame = -1;
    this.#resized.disconnect();
    this.#seen.disconnect();
    document.removeEventListener("visibilitychange", this.draw);
    this.#host.removeEventListener("focusin", this.#taken);
    this.#host.removeEventListener("focusout", this.#left);
    this.#controls.dispose();
    this.#grid?.dispose();
    this.figure.dispose();
    this.#ground.geometry.dispose();
    this.#sun.dispose();
    this.#renderer.dispose();
    this.#renderer.forceContextLoss(); // browsers limit the contexts, and collect them late
    this.#renderer.domElement.remove();
  }

  /** The place on the plane of picking below a point of the screen; null above the horizon. */
  placeAt(clientX: number, clientY: number): Place | null {
    const box = this.#renderer.domElement.getBoundingClientRect();
    const at = new Vector2((2 * (clientX - box.left)) / box.width - 1, 1 - (2 * (clientY - box.top)) / box.height);
    const ray = new Raycaster();
    ray.setFromCamera(at, this.#camera);
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

  readonly #taken = (): void => {
    this.#controls.enableZoom = true;
  };

  readonly #left = (): void => {
    this.#controls.enableZoom = false;
  };

  #follow(x: number, y: number): void {
    const { target } = this.#controls;
    const [dx, dy] = [x - target.x, y - target.y];
    if (Math.hypot(dx, dy) < FOLLOWS_M) return;
    target.x = x;
    target.y = y;
    this.#camera.position.x += dx;
    this.#camera.position.y += dy;
    this.#sun.position.set(x - 1.2, y - 1.8, 3);
    this.#sun.target.position.set(x, y, MIDDLE_M);
    this.#controls.update();
  }

  #fit(): void {
    const { clientWidth: width, clientHeight: height } = this.#host;
    if (width === 0 || height === 0) return;
    this.#renderer.setSize(width, height);
    this.#camera.aspect = width / height;
    this.#camera.updateProjectionMatrix();
    this.draw();
  }
}
