/** The picture of virtual reality: how it is rendered with and without a graphics card, its size on the page, and when it is drawn. */
import { PCFShadowMap, type PerspectiveCamera, type Scene, WebGLRenderer } from "three";
import { Visibility } from "~/design/frameScheduler";
import { drawsInSoftware, picturePeriodMs } from "~/robot3d/graphicsCard";
import { ScenePicture } from "~/robot3d/scenePicture";
import { PictureEnd } from "./pictureEnd";

export class Display {
  readonly renderer: WebGLRenderer;
  readonly #host: HTMLElement;
  readonly #picture: ScenePicture;
  readonly #visibility: Visibility;
  readonly #pictureEnd: PictureEnd;
  readonly #isSlow = drawsInSoftware();
  #drawnMs = -Infinity;
  #isDrawing = false;

  /** Throws where the browser has no WebGL. */
  constructor(host: HTMLElement) {
    this.#host = host;
    // In software, smooth edges and shadows take most of the time of a frame, and a late hand is worse than a rough one.
    this.renderer = new WebGLRenderer({ antialias: !this.#isSlow });
    this.renderer.setPixelRatio(this.#isSlow ? 1 : Math.min(devicePixelRatio, 2));
    this.renderer.shadowMap.enabled = !this.#isSlow;
    this.renderer.shadowMap.type = PCFShadowMap;
    this.renderer.xr.enabled = true;
    this.#picture = new ScenePicture(this.renderer);
    this.#pictureEnd = new PictureEnd(this.renderer.getContext() as WebGL2RenderingContext);
    this.#visibility = new Visibility(host);
    this.canvas.setAttribute("aria-hidden", "true");
    this.canvas.addEventListener("webglcontextrestored", this.#picture.invalidate);
    host.append(this.canvas);
  }

  get canvas(): HTMLCanvasElement {
    return this.renderer.domElement;
  }

  /** Give the picture and a camera the size of the page's element. */
  fit(camera: PerspectiveCamera): void {
    const { clientWidth: width, clientHeight: height } = this.#host;
    if (width === 0 || height === 0) return;
    this.renderer.setSize(width, height);
    this.#picture.invalidate();
    camera.aspect = width / height;
    camera.updateProjectionMatrix();
  }

  /** Draw what a headset shows. Returns whether it was drawn: in software not each frame is. */
  drawForHeadset(nowMs: number, scene: Scene, camera: PerspectiveCamera): boolean {
    if (!this.#isDue(nowMs)) return false;
    this.renderer.render(scene, camera);
    this.#drawnMs = nowMs;
    return true;
  }

  /** Draw the picture on the page. Returns whether it was drawn: not if nobody would see a difference, unless `always`. */
  drawOnPage(nowMs: number, scene: Scene, camera: PerspectiveCamera, always: boolean): boolean {
    if (!this.#isDue(nowMs) || !this.#visibility.isVisible) return false;
    if (always) this.#picture.invalidate();
    if (!this.#picture.draw(scene, camera)) return false;
    this.#drawnMs = nowMs;
    return true;
  }

  /** Call `onDrawn` when the picture that was just given to the graphics is drawn. */
  end(nowMs: number, onDrawn: (drawnMs: number) => void): void {
    this.#isDrawing = true;
    this.#pictureEnd.after(nowMs, (drawnMs) => {
      this.#isDrawing = false;
      if (drawnMs !== null) onDrawn(drawnMs);
    });
  }

  /** Whether pictures wait for each other: those that queue for a processor make all that is shown late. */
  get isSlow(): boolean {
    return this.#isSlow;
  }

  dispose(): void {
    this.#pictureEnd.dispose();
    this.#visibility.dispose();
    this.renderer.dispose();
    this.canvas.remove();
  }

  #isDue(nowMs: number): boolean {
    return !(this.#isSlow && this.#isDrawing) && nowMs - this.#drawnMs >= picturePeriodMs();
  }
}
