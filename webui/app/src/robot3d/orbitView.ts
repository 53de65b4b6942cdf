/**
 * A 3D view that a user turns around a target (z is up, metres): renderer, camera, light, ground grid and controls. It
 * is drawn when it would look different, never while nobody can see it, and less often without a graphics card; what
 * the user does is drawn with the next frame.
 */
import { type ColorRepresentation, DirectionalLight, type GridHelper, PerspectiveCamera, Scene, WebGLRenderer } from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { FrameScheduler } from "~/design/frameScheduler";
import { drawsInSoftware } from "./graphicsCard";
import { ambientLights, groundGrid } from "./light";
import { DISTANCES, type Distances, stepOf, stepped } from "./orbit";
import { ScenePicture } from "./scenePicture";

const MAX_PIXEL_RATIO = 2;
/** The shortest time between two pictures that are drawn in software: 10 a second, each of which takes half of it on a processor core. */
const SOFTWARE_PERIOD_MS = 96;

export interface OrbitEvents {
  /** Move what is in the scene before a frame; returns whether another frame follows. */
  onFrame?: (nowMs: number) => boolean;
  /** The size has changed, before the next frame. */
  onFit?: () => void;
}

export class OrbitView {
  readonly scene = new Scene();
  readonly camera = new PerspectiveCamera(38, 1, 0.05, 40);
  readonly sun = new DirectionalLight("#ffffff", 2.2);
  readonly canvas: HTMLCanvasElement;
  readonly controls: OrbitControls;
  readonly #host: HTMLElement;
  readonly #renderer: WebGLRenderer;
  readonly #events: OrbitEvents;
  readonly #resized: ResizeObserver;
  readonly #frames: FrameScheduler;
  readonly #picture: ScenePicture;
  #distances: Distances = DISTANCES;
  #grid: GridHelper | null = null;
  #isTurning = false;

  /** Throws when the browser has no WebGL. */
  constructor(host: HTMLElement, maxPolarAngle: number, events: OrbitEvents = {}) {
    this.#host = host;
    this.#events = events;
    this.#renderer = new WebGLRenderer({ antialias: true, powerPreference: "low-power" });
    this.#renderer.setPixelRatio(Math.min(devicePixelRatio, MAX_PIXEL_RATIO));
    // In software, shadows take half of the time of a picture, which services on the same computer need.
    const isSlow = drawsInSoftware();
    this.#renderer.shadowMap.enabled = !isSlow;
    this.canvas = this.#renderer.domElement;
    this.canvas.setAttribute("aria-hidden", "true");
    host.append(this.canvas);
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, this.canvas);
    this.controls.maxPolarAngle = maxPolarAngle;
    // The wheel scrolls the page until the view has been used; vertical touch gestures always scroll.
    this.controls.enableZoom = false;
    this.canvas.style.touchAction = "pan-y";
    this.#picture = new ScenePicture(this.#renderer);
    this.#frames = new FrameScheduler(host, (nowMs) => this.#draw(nowMs), isSlow ? SOFTWARE_PERIOD_MS : 0);
    this.controls.addEventListener("start", () => (this.#isTurning = true));
    this.controls.addEventListener("end", () => (this.#isTurning = false));
    // A view that follows its robot changes the camera as well, and is no faster than the robot.
    this.controls.addEventListener("change", () => (this.#isTurning ? this.drawNow() : this.draw()));
    this.scene.add(this.sun, this.sun.target, ...ambientLights());
    this.#resized = new ResizeObserver(() => this.#fit());
    this.#resized.observe(host);
    host.addEventListener("focusin", this.#taken);
    host.addEventListener("focusout", this.#left);
    this.canvas.addEventListener("webglcontextrestored", this.#redraw);
  }

  /** How near and far the camera may be. */
  set distances(distances: Distances) {
    this.#distances = distances;
    this.controls.minDistance = distances.least;
    this.controls.maxDistance = distances.most;
  }

  recolour(background: string, line: ColorRepresentation, sizeM: number, groundM: number): void {
    this.#renderer.setClearColor(background);
    this.#dropGrid();
    this.#grid = groundGrid(sizeM, line);
    this.#grid.position.z = groundM;
    this.scene.add(this.#grid);
    this.#redraw();
  }

  /** Turn the view by a key: whether it did, or was asked for the initial view. */
  key(key: string): boolean | "reset" {
    const step = stepOf(key);
    if (step === null || step === "reset") return step ?? false;
    this.camera.position.set(...stepped(this.camera.position.toArray(), this.controls.target.toArray(), step, this.#distances));
    this.controls.update();
    this.drawNow();
    return true;
  }

  /** Request a frame for what moves by itself. */
  readonly draw = (): void => this.#frames.request();

  /** Request a frame for what a user does. */
  readonly drawNow = (): void => this.#frames.requestNow();

  dispose(): void {
    this.#frames.dispose();
    this.#resized.disconnect();
    this.#host.removeEventListener("focusin", this.#taken);
    this.#host.removeEventListener("focusout", this.#left);
    this.controls.dispose();
    this.#dropGrid();
    this.sun.dispose();
    this.#renderer.dispose();
    // Browsers limit WebGL contexts to about 16: release it now, not at garbage collection.
    this.#renderer.forceContextLoss();
    this.canvas.remove();
  }

  #draw(nowMs: number): boolean {
    const continues = this.#events.onFrame?.(nowMs) ?? false;
    this.#picture.draw(this.scene, this.camera);
    return continues;
  }

  readonly #redraw = (): void => {
    this.#picture.invalidate();
    this.drawNow();
  };

  readonly #taken = (): void => {
    this.controls.enableZoom = true;
  };

  readonly #left = (): void => {
    this.controls.enableZoom = false;
  };

  #dropGrid(): void {
    this.#grid?.removeFromParent();
    this.#grid?.dispose();
    this.#grid = null;
  }

  #fit(): void {
    const { clientWidth: width, clientHeight: height } = this.#host;
    if (width === 0 || height === 0) return;
    this.#renderer.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.#events.onFit?.();
    this.#redraw();
  }
}
