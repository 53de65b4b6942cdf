/**
 * A 3D view that a user turns around a target (z is up, metres): renderer, camera, light, ground grid and controls. It
 * renders only when it is asked to, and never while it is not visible.
 */
import { type ColorRepresentation, DirectionalLight, type GridHelper, PerspectiveCamera, Scene, WebGLRenderer } from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import { ambientLights, groundGrid } from "./light";
import { DISTANCES, type Distances, stepOf, stepped } from "./orbit";

const MAX_PIXEL_RATIO = 2;

export interface OrbitEvents {
  /** Before a frame is drawn; returns whether another one follows. */
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
  readonly #seen: IntersectionObserver;
  #distances: Distances = DISTANCES;
  #grid: GridHelper | null = null;
  #frame = 0;
  #isInView = true;

  /** Throws when the browser has no WebGL. */
  constructor(host: HTMLElement, maxPolarAngle: number, events: OrbitEvents = {}) {
    this.#host = host;
    this.#events = events;
    this.#renderer = new WebGLRenderer({ antialias: true, powerPreference: "low-power" });
    this.#renderer.setPixelRatio(Math.min(devicePixelRatio, MAX_PIXEL_RATIO));
    this.#renderer.shadowMap.enabled = true;
    this.canvas = this.#renderer.domElement;
    this.canvas.setAttribute("aria-hidden", "true");
    host.append(this.canvas);
    this.camera.up.set(0, 0, 1);
    this.controls = new OrbitControls(this.camera, this.canvas);
    this.controls.maxPolarAngle = maxPolarAngle;
    // The wheel scrolls the page until the view has been used; vertical touch gestures always scroll.
    this.controls.enableZoom = false;
    this.canvas.style.touchAction = "pan-y";
    this.controls.addEventListener("change", this.draw);
    this.scene.add(this.sun, this.sun.target, ...ambientLights());
    this.#resized = new ResizeObserver(() => this.#fit());
    this.#resized.observe(host);
    this.#seen = new IntersectionObserver(([entry]) => {
      this.#isInView = entry?.isIntersecting ?? true;
      this.draw();
    });
    this.#seen.observe(host);
    document.addEventListener("visibilitychange", this.draw);
    host.addEventListener("focusin", this.#taken);
    host.addEventListener("focusout", this.#left);
    this.canvas.addEventListener("webglcontextrestored", this.draw);
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
    this.draw();
  }

  /** Turn the view by a key: whether it did, or was asked for the initial view. */
  key(key: string): boolean | "reset" {
    const step = stepOf(key);
    if (step === null || step === "reset") return step ?? false;
    this.camera.position.set(...stepped(this.camera.position.toArray(), this.controls.target.toArray(), step, this.#distances));
    this.controls.update();
    this.draw();
    return true;
  }

  /** Request a frame if the view is visible. */
  readonly draw = (): void => {
    if (this.#frame !== 0 || document.hidden || !this.#isInView) return;
    this.#frame = requestAnimationFrame((nowMs) => {
      this.#frame = 0;
      const goesOn = this.#events.onFrame?.(nowMs) ?? false;
      this.#renderer.render(this.scene, this.camera);
      if (goesOn) this.draw();
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
    this.controls.dispose();
    this.#dropGrid();
    this.sun.dispose();
    this.#renderer.dispose();
    // Browsers limit WebGL contexts to about 16: release it now, not at garbage collection.
    this.#renderer.forceContextLoss();
    this.canvas.remove();
  }

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
    this.draw();
  }
}
