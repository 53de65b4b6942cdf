/**
 * When a picture is drawn. The page does not wait for it: it gives a fence to the graphics, and asks for it every
 * millisecond, so that messages and frames come meanwhile as they do without being measured.
 */

const ASK_MS = 1;
/** A context that is lost never answers. */
const LONGEST_MS = 5000;

export class PictureEnd {
  readonly #gl: WebGL2RenderingContext;
  readonly #channel = new MessageChannel();
  readonly #waiting: { fence: WebGLSync; sinceMs: number; onEnd: (drawnMs: number | null) => void }[] = [];
  #isAsking = false;

  constructor(gl: WebGL2RenderingContext) {
    this.#gl = gl;
    // timers that set each other come every 4 ms; one that a message sets comes after 1 ms
    this.#channel.port1.onmessage = () => setTimeout(() => this.#ask(), ASK_MS);
  }

  /** Call `onEnd` when all that was given to the graphics until now is drawn; with null if that cannot be known. */
  after(nowMs: number, onEnd: (drawnMs: number | null) => void): void {
    const fence = this.#gl.fenceSync(this.#gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    if (fence === null) {
      onEnd(null);
      return;
    }
    this.#gl.flush();
    this.#waiting.push({ fence, sinceMs: nowMs, onEnd });
    if (this.#isAsking) return;
    this.#isAsking = true;
    this.#channel.port2.postMessage(null);
  }

  dispose(): void {
    this.#channel.port1.close();
    for (const { fence } of this.#waiting.splice(0)) this.#gl.deleteSync(fence);
  }

  #ask(): void {
    const nowMs = performance.now();
    for (let first = this.#waiting[0]; first !== undefined; first = this.#waiting[0]) {
      const isDrawn = this.#gl.getSyncParameter(first.fence, this.#gl.SYNC_STATUS) === this.#gl.SIGNALED;
      if (!isDrawn && nowMs - first.sinceMs < LONGEST_MS) break;
      this.#waiting.shift();
      this.#gl.deleteSync(first.fence);
      first.onEnd(isDrawn ? nowMs : null);
    }
    this.#isAsking = this.#waiting.length > 0;
    if (this.#isAsking) this.#channel.port2.postMessage(null);
  }
}
