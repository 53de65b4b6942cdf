/**
 * The stage: the robot in its cell, drawn by three. It draws only when something has changed, a joint, the
 * camera, the theme, the size, and not at all while nobody can see it.
 */
import {
  AmbientLight, BoxGeometry, type ColorRepresentation, DirectionalLight, EdgesGeometry, GridHelper, Group,
  HemisphereLight, LineBasicMaterial, LineSegments, Mesh, MeshStandardMaterial, PerspectiveCamera, Scene, Vector3,
  WebGLRenderer,
} from "three";
import { OrbitControls } from "three/addons/controls/OrbitControls.js";
import type { URDFRobot } from "urdf-loader";
import { bend, grip, release } from "./description";
import { type CellScene, furnitureOf, PART_SIZE, type Piece, type PieceKind } from "./furniture";
import { JointTrack } from "./joint_track";
import { MAX_DISTANCE_M, MIN_DISTANCE_M, stepOf, stepped } from "./orbit";

const CAMERA: [number, number, number] = [-2.05, -1.5, 1.25];
const LOOKS_AT: [number, number, number] = [-0.3, -0.05, 0.27];
/** Wider than high, the arm fits at any height; on a narrow screen the camera steps back. */
const FITS_AT_ASPECT = 1.3;
const MAX_PIXEL_RATIO = 2;
const GROUND_M = -0.051;

/** The colours of the page, read from its tokens. */
export interface Palette {
  ground: string;
  table: string;
  line: string;
  fixture: string;
  bin: string;
  part: string;
}

export class Stage {
  readonly #host: HTMLElement;
  readonly #renderer: WebGLRenderer;
  readonly #scene = new Scene();
  readonly #camera = new PerspectiveCamera(38, 1, 0.05, 20);
  readonly #controls: OrbitControls;
  readonly #resized: ResizeObserver;
  readonly #seen: IntersectionObserver;
  readonly #furniture = new Group();
  readonly #track = new JointTrack();
  readonly #robot: URDFRobot;
  readonly #held: Mesh;
  #palette: Palette;
  #grid: GridHelper | null = null;
  #cell: CellScene | null = null;
  #names: readonly string[] = [];
  #gripper = "";
  #frame = 0;
  #inView = true;

  /** Throws when the browser has no WebGL. */
  constructor(host: HTMLElement, robot: URDFRobot, palette: Palette) {
    this.#host = host;
    this.#robot = robot;
    this.#palette = palette;
    this.#renderer = new WebGLRenderer({ antialias: true, powerPreference: "low-power" });
    this.#renderer.setPixelRatio(Math.min(devicePixelRatio, MAX_PIXEL_RATIO));
    this.#renderer.shadowMap.enabled = true;
    this.#renderer.domElement.setAttribute("aria-hidden", "true");
    host.append(this.#renderer.domElement);

    this.#camera.up.set(0, 0, 1);
    this.#controls = new OrbitControls(this.#camera, this.#renderer.domElement);
    this.#controls.minDistance = MIN_DISTANCE_M;
    this.#controls.maxDistance = MAX_DISTANCE_M;
    this.#controls.maxPolarAngle = Math.PI / 2 + 0.08;
    // The wheel scrolls the page until somebody takes the view in hand; a finger goes on to scroll up and down.
    this.#controls.enableZoom = false;
    this.#renderer.domElement.style.touchAction = "pan-y";
    this.#controls.addEventListener("change", this.draw);

    this.#held = new Mesh(new BoxGeometry(...PART_SIZE), new MeshStandardMaterial());
    this.#held.visible = false;
    this.#held.castShadow = true;
    robot.links["tip"]?.add(this.#held);
    this.#scene.add(robot, this.#furniture, ...lights());
    this.restyle(palette);
    this.reset();

    this.#resized = new ResizeObserver(() => this.#fit());
    this.#resized.observe(host);
    this.#seen = new IntersectionObserver(([entry]) => {
      this.#inView = entry?.isIntersecting ?? true;
      this.draw();
    });
    this.#seen.observe(host);
    document.addEventListener("visibilitychange", this.draw);
    host.addEventListener("focusin", this.#taken);
    host.addEventListener("focusout", this.#left);
    this.#renderer.domElement.addEventListener("webglcontextrestored", this.draw);
  }

  /** Take notice of the joints as they are now; the arm glides there. */
  joints(names: readonly string[], positions: readonly number[]): void {
    this.#names = names;
    if (this.#track.push(positions, performance.now())) this.draw();
  }

  gripper(closed: boolean, holds: boolean): void {
    const state = `${closed} ${holds}`;
    if (state === this.#gripper) return;
    this.#gripper = state;
    grip(this.#robot, closed, holds);
    this.#held.visible = holds;
    this.draw();
  }

  /** Put up what stands round the robot. */
  furnish(cell: CellScene | null): void {
    this.#cell = cell;
    for (const piece of [...this.#furniture.children]) release(piece);
    for (const piece of furnitureOf(cell)) this.#furniture.add(this.#piece(piece));
    this.draw();
  }

  restyle(palette: Palette): void {
    this.#palette = palette;
    this.#renderer.setClearColor(palette.ground);
    (this.#held.material as MeshStandardMaterial).color.set(palette.part);
    this.#dropGrid();
    this.#grid = new GridHelper(6, 24, palette.line, palette.line);
    this.#grid.rotateX(Math.PI / 2);
    this.#grid.position.z = GROUND_M;
    this.#scene.add(this.#grid);
    this.furnish(this.#cell);
  }

  /** Answer a key; returns whether it meant something. */
  key(key: string): boolean {
    const step = stepOf(key);
    if (step === null) return false;
    if (step === "reset") {
      this.reset();
    } else {
      const target = this.#controls.target;
      this.#camera.position.set(...stepped(this.#camera.position.toArray(), target.toArray(), step));
      this.#controls.update();
    }
    this.draw();
    return true;
  }

  /** Look at the cell as at first. */
  reset(): void {
    const back = Math.max(1, FITS_AT_ASPECT / this.#camera.aspect);
    const target = new Vector3(...LOOKS_AT);
    this.#controls.target.copy(target);
    this.#camera.position.set(...CAMERA).sub(target).multiplyScalar(back).add(target);
    this.#controls.update();
    this.draw();
  }

  /** Have a picture drawn soon, if anybody can see it. */
  readonly draw = (): void => {
    if (this.#frame !== 0 || document.hidden || !this.#inView) return;
    this.#frame = requestAnimationFrame((nowMs) => {
      this.#frame = 0;
      bend(this.#robot, this.#names, this.#track.at(nowMs));
      this.#renderer.render(this.#scene, this.#camera);
      if (this.#track.glides(nowMs)) this.draw();
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
    this.#dropGrid();
    for (const piece of [...this.#furniture.children]) release(piece);
    release(this.#robot);
    for (const light of this.#scene.children) if (light instanceof DirectionalLight) light.dispose();
    this.#renderer.dispose();
    // A browser gives out only some sixteen contexts; one that waits for the collector may be one too many.
    this.#renderer.forceContextLoss();
    this.#renderer.domElement.remove();
  }

  readonly #taken = (): void => {
    this.#controls.enableZoom = true;
  };

  readonly #left = (): void => {
    this.#controls.enableZoom = false;
  };

  #fit(): void {
    const { clientWidth: width, clientHeight: height } = this.#host;
    if (width === 0 || height === 0) return;
    const first = this.#camera.aspect === 1;
    this.#renderer.setSize(width, height);
    this.#camera.aspect = width / height;
    this.#camera.updateProjectionMatrix();
    if (first) this.reset();
    this.draw();
  }

  #piece({ kind, size, position, orientation }: Piece): Group {
    const geometry = new BoxGeometry(...size);
    const see = kind === "bin";
    const material = new MeshStandardMaterial({
      color: this.#colour(kind), roughness: 0.85, transparent: see, opacity: see ? 0.45 : 1, depthWrite: !see,
    });
    const mesh = new Mesh(geometry, material);
    mesh.castShadow = kind === "part";
    mesh.receiveShadow = !see;
    const piece = new Group();
    piece.add(mesh, new LineSegments(new EdgesGeometry(geometry), new LineBasicMaterial({ color: this.#palette.line })));
    piece.position.set(...position);
    piece.quaternion.set(...orientation);
    return piece;
  }

  #colour(kind: PieceKind): ColorRepresentation {
    const { table, fixture, bin, line, part } = this.#palette;
    return { table, fixture, bin, nest: line, part }[kind];
  }

  #dropGrid(): void {
    this.#grid?.dispose();
    this.#grid?.removeFromParent();
  }
}

function lights(): (AmbientLight | HemisphereLight | DirectionalLight)[] {
  const sun = new DirectionalLight("#ffffff", 2.2);
  sun.position.set(-1.2, -1.8, 3);
  sun.castShadow = true;
  sun.shadow.mapSize.set(1024, 1024);
  Object.assign(sun.shadow.camera, { left: -1.6, right: 1.6, top: 1.6, bottom: -1.6, near: 0.5, far: 6 });
  sun.shadow.bias = -0.0006;
  sun.shadow.normalBias = 0.02;
  return [new HemisphereLight("#ffffff", "#8090a8", 1.3), new AmbientLight("#ffffff", 0.25), sun];
}
