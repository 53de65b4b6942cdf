/**
 * When a view is drawn: with the next frame of the screen after a request, once for all requests until then, and never
 * while nobody can see it. A view that is seen again is drawn then.
 *
 * `request` is for what changes by itself. Where a picture takes long, a period limits how often it is drawn.
 * `requestNow` is for what a person does: it does not wait for the period.
 */

/** Whether an element can be seen: it is in the viewport, of a page that is not hidden. */
export class Visibility {
  #isInViewport = true;
  readonly #observer: IntersectionObserver;
  readonly #onChange: () => void;

  constructor(host: Element, onChange: () => void = () => undefined) {
    this.#onChange = onChange;
    this.#observer = new IntersectionObserver((entries) => {
      this.#isInViewport = entries.at(-1)?.isIntersecting ?? true;
      onChange();
    });
    this.#observer.observe(host);
    document.addEventListener("visibilitychange", onChange);
  }

  get isVisible(): boolean {
    return this.#isInViewport && !document.hidden;
  }

  dispose(): void {
    this.#observer.disconnect();
    document.removeEventListener("visibilitychange", this.#onChange);
  }
}

export class FrameScheduler {
  #frame: number | null = null;
  #timer: ReturnType<typeof setTimeout> | undefined;
  #drawnMs = -Infinity;
  #isDrawing = false;
  #isDisposed = false;
  readonly #visibility: Visibility;
  readonly #draw: (nowMs: number) => boolean;
  readonly #periodMs: number;

  /** `draw` returns whether another frame follows; `periodMs` is the shortest time between two frames of requests. */
  constructor(host: Element, draw: (nowMs: number) => boolean, periodMs = 0) {
    this.#draw = draw;
    this.#periodMs = periodMs;
    this.#visibility = new Visibility(host, () => this.requestNow());
  }

  /** Draw when the period since the last frame has passed. */
  readonly request = (): void => {
    if (this.#timer !== undefined || !this.#isOpen) return;
    const restMs = this.#drawnMs + this.#periodMs - performance.now();
    if (restMs <= 0) {
      this.requestNow();
      return;
    }
    this.#timer = setTimeout(() => {
      this.#timer = undefined;
      this.requestNow();
    }, restMs);
  };

  /** Draw with the next frame of the screen. */
  readonly requestNow = (): void => {
    if (!this.#isOpen) return;
    this.#forgetTimer();
    this.#frame = requestAnimationFrame((nowMs) => this.#onFrame(nowMs));
  };

  dispose(): void {
    this.#isDisposed = true;
    this.#visibility.dispose();
    this.#forgetTimer();
    if (this.#frame !== null) cancelAnimationFrame(this.#frame);
  }

  /** Whether a request is of use: what drawing itself requests is part of the picture, and one frame is enough. */
  get #isOpen(): boolean {
    return this.#frame === null && !this.#isDrawing && !this.#isDisposed && this.#visibility.isVisible;
  }

  #onFrame(nowMs: number): void {
    this.#frame = null;
    this.#drawnMs = performance.now();
    this.#isDrawing = true;
    let continues: boolean;
    try {
      continues = this.#draw(nowMs);
    } finally {
      this.#isDrawing = false;
    }
    if (continues) this.request();
  }

  #forgetTimer(): void {
    clearTimeout(this.#timer);
    this.#timer = undefined;
  }
}
