/**
 * The picture of a scene, drawn again only when it would look different. A robot that stands still sends states all
 * the same, whose differences are smaller than a pixel.
 *
 * Compared are the camera, and of all visible objects place, turn, size, colour, texture and form.
 */
import { BufferGeometry, type Camera, InstancedMesh, Line, type Material, Mesh, type Object3D, type Scene, type Texture } from "three";

/** In m, and of a turn in rad: below a pixel of a robot that fills the picture. */
const SAME = 5e-4;
/** The camera moves everything that is far from it. */
const SAME_CAMERA = 1e-5;
/** Forms with more corners are compared by their versions. */
const MAX_COMPARED_CORNERS = 32;

export interface SceneRenderer {
  render: (scene: Scene, camera: Camera) => void;
}

export class ScenePicture {
  #isStale = true;
  #drawn: number[] = [];
  #next: number[] = [];
  readonly #renderer: SceneRenderer;

  constructor(renderer: SceneRenderer) {
    this.#renderer = renderer;
  }

  /** Draw it next time in any case: the canvas has been cleared, or something changed that is not compared. */
  readonly invalidate = (): void => {
    this.#isStale = true;
  };

  /** Draw the scene if it looks different; returns whether it did. */
  draw(scene: Scene, camera: Camera): boolean {
    if (!this.#hasChanged(scene, camera)) return false;
    this.#isStale = false;
    [this.#drawn, this.#next] = [this.#next, this.#drawn];
    this.#renderer.render(scene, camera);
    return true;
  }

  #hasChanged(scene: Scene, camera: Camera): boolean {
    const next = this.#next;
    next.length = 0;
    camera.updateMatrixWorld();
    next.push(...camera.matrixWorld.elements, ...camera.projectionMatrix.elements);
    const ofCamera = next.length;
    scene.updateMatrixWorld();
    scene.traverseVisible((object) => describe(object, next));
    const drawn = this.#drawn;
    if (this.#isStale || next.length !== drawn.length) return true;
    return next.some((value, index) => Math.abs(value - (drawn[index] ?? 0)) > (index < ofCamera ? SAME_CAMERA : SAME));
  }
}

/** Append to `out` what makes the look of an object. */
function describe(object: Object3D, out: number[]): void {
  out.push(object.id, ...object.matrixWorld.elements);
  if (!(object instanceof Mesh || object instanceof Line)) return;
  const { geometry, material } = object as { geometry: BufferGeometry; material: Material | Material[] };
  const corners = geometry.getAttribute("position") as BufferGeometry["attributes"][string] | undefined;
  if (corners === undefined) return;
  if (corners.count > MAX_COMPARED_CORNERS) out.push(geometry.id, "version" in corners ? corners.version : corners.data.version);
  else for (let corner = 0; corner < corners.count; corner += 1) out.push(corners.getX(corner), corners.getY(corner), corners.getZ(corner));
  if (object instanceof InstancedMesh) out.push(object.count, object.instanceMatrix.version);
  for (const each of Array.isArray(material) ? material : [material]) {
    const { color, map, opacity } = each as Material & { color?: { r: number; g: number; b: number }; map?: Texture | null };
    out.push(each.id, opacity, color?.r ?? 0, color?.g ?? 0, color?.b ?? 0, map?.version ?? 0);
  }
}
