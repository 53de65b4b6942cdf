/**
 * Drawing: a BPMN file on the page, with marks on its elements. The file is read once; what changes
 * afterwards are the marks alone. The mark of bpmn.io stays as the library puts it.
 */
import NavigatedViewer from "bpmn-js/lib/NavigatedViewer";
import type Canvas from "diagram-js/lib/core/Canvas";
import type ElementRegistry from "diagram-js/lib/core/ElementRegistry";
import type { ElementLike } from "diagram-js/lib/core/Types";
import type EventBus from "diagram-js/lib/core/EventBus";
import type Overlays from "diagram-js/lib/features/overlays/Overlays";
import { difference, NO_MARKS, type Badge, type Marks } from "./marks";

interface Services {
  canvas: Canvas;
  elementRegistry: ElementRegistry;
  eventBus: EventBus;
  overlays: Overlays;
}

interface Picked {
  element: { businessObject?: { id?: string } };
}

const MARGIN = 16;
/** Below lie the zoom buttons and the mark of bpmn.io, which nothing may cover. */
const FOOT = 52;
const MIN_ZOOM = 0.2;
const MAX_ZOOM = 4;
/** A small process is not blown up to fill the place. */
const FIT_ZOOM = 1.25;

const SIGNS: Record<Badge["kind"], string> = { token: "●", incident: "!", failed: "✕", count: "✓", duration: "", fault: "!", warning: "⚠", waiting: "…" };

export class Drawing {
  readonly #viewer: NavigatedViewer<Services>;
  readonly #overlays = new Map<string, string[]>();
  #shown: Marks = NO_MARKS;
  #ready = false;
  #moved = false;

  constructor(container: HTMLElement, onPick: (element: string | null) => void) {
    this.#viewer = new NavigatedViewer<Services>({
      container,
      keyboard: { bind: false },
      bpmnRenderer: {
        defaultFillColor: "var(--diagram-fill)",
        defaultStrokeColor: "var(--diagram-stroke)",
        defaultLabelColor: "var(--text)",
      },
      textRenderer: {
        defaultStyle: { fontFamily: "Inter Variable, sans-serif", fontSize: 12 },
        externalStyle: { fontFamily: "Inter Variable, sans-serif", fontSize: 11 },
      },
    });
    const events = this.#viewer.get("eventBus");
    events.on("element.click", (event: Picked) => onPick(event.element.businessObject?.id ?? null));
    events.on(["canvas.viewbox.changing"], () => {
      this.#moved = true;
    });
  }

  /** Draw a file; throws the error of the library if it cannot read the file. */
  async show(xml: string): Promise<void> {
    this.#ready = false;
    this.#shown = NO_MARKS;
    this.#overlays.clear();
    await this.#viewer.importXML(xml);
    this.#ready = true;
    this.fit();
  }

  /** Replace the shown marks; only changed marks are redrawn. */
  mark(marks: Marks): void {
    if (!this.#ready) return;
    const change = difference(this.#shown, marks);
    this.#shown = marks;
    const canvas = this.#viewer.get("canvas");
    for (const { element, look } of change.lose) this.#at(element, (at) => canvas.removeMarker(at, `diagram-${look}`));
    for (const { element, look } of change.gain) {
      if (look === "token" && this.#isAttached(element)) continue;
      this.#at(element, (at) => canvas.addMarker(at, `diagram-${look}`));
    }
    for (const { element, badges } of change.badges) this.#badge(element, badges);
  }

  /** Move an element to the middle; false if the drawing does not have it. */
  centre(element: string): boolean {
    const at = this.#find(element);
    if (at === undefined) return false;
    const canvas = this.#viewer.get("canvas");
    canvas.scrollToElement(at, MARGIN);
    const box = canvas.viewbox();
    const middle = middleOf(at);
    const zoom = Math.max(box.scale, 0.8);
    const [width, height] = [box.outer.width / zoom, box.outer.height / zoom];
    canvas.viewbox({ x: middle.x - width / 2, y: middle.y - height / 2, width, height });
    return true;
  }

  /** Show the whole drawing. */
  fit(): void {
    if (!this.#ready) return;
    const canvas = this.#viewer.get("canvas");
    canvas.resized();
    const { inner, outer } = canvas.viewbox();
    if (outer.width === 0 || outer.height === 0) return;
    const [across, down] = [outer.width - 2 * MARGIN, outer.height - MARGIN - FOOT];
    const zoom = Math.max(MIN_ZOOM, Math.min(FIT_ZOOM, across / inner.width, down / inner.height));
    canvas.viewbox({
      x: inner.x - (across / zoom - inner.width) / 2 - MARGIN / zoom,
      y: inner.y - (down / zoom - inner.height) / 2 - MARGIN / zoom,
      width: outer.width / zoom,
      height: outer.height / zoom,
    });
    this.#moved = false;
  }

  /** The place of the drawing has another size: what was fitted stays fitted, what was moved stays there. */
  resized(): void {
    if (!this.#ready) return;
    if (this.#moved) this.#viewer.get("canvas").resized();
    else this.fit();
  }

  zoomBy(factor: number): void {
    if (!this.#ready) return;
    const canvas = this.#viewer.get("canvas");
    canvas.zoom(Math.min(MAX_ZOOM, Math.max(MIN_ZOOM, canvas.zoom() * factor)));
  }

  pan(dx: number, dy: number): void {
    if (this.#ready) this.#viewer.get("canvas").scroll({ dx, dy });
  }

  destroy(): void {
    this.#ready = false;
    this.#viewer.destroy();
  }

  #badge(element: string, badges: readonly Badge[]): void {
    const overlays = this.#viewer.get("overlays");
    for (const overlay of this.#overlays.get(element) ?? []) overlays.remove(overlay);
    this.#overlays.delete(element);
    const at = this.#find(element);
    if (at === undefined || badges.length === 0) return;
    const width = "waypoints" in at ? 0 : (at as unknown as { width: number }).width;
    const attached = this.#isAttached(element);
    const above = badges.filter(
      (badge) => badge.kind !== "count" && badge.kind !== "duration" && !(attached && badge.kind === "token"),
    );
    const below = badges.filter((badge) => badge.kind === "count" || badge.kind === "duration");
    const put = (row: readonly Badge[], position: { top?: number; bottom?: number; left: number }) =>
      row.length === 0 ? [] : [overlays.add(at as never, { position, html: rowOf(row, width), scale: { min: 0.7, max: 1.4 } })];
    this.#overlays.set(element, [...put(above, { top: -11, left: 0 }), ...put(below, { bottom: 9, left: 0 })]);
  }

  #at(element: string, act: (at: never) => void): void {
    const at = this.#find(element);
    if (at !== undefined) act(at as never);
  }

  /** The shape of an element; a process that is drawn as a pool is found by its pool. */
  #find(element: string): ElementLike | undefined {
    const registry = this.#viewer.get("elementRegistry");
    const drawn = registry.get(element);
    if (drawn !== undefined) return this.#isGround(drawn) ? undefined : drawn;
    return registry.find(
      (one: { businessObject?: { processRef?: { id?: string } } }) => one.businessObject?.processRef?.id === element,
    );
  }

  /** An event on the edge of an activity waits with it, but the token is the activity's. */
  #isAttached(element: string): boolean {
    const at = this.#find(element) as { businessObject?: { $type?: string } } | undefined;
    return at?.businessObject?.$type === "bpmn:BoundaryEvent";
  }

  #isGround(element: ElementLike): boolean {
    return (this.#viewer.get("canvas").getRootElement() as unknown) === element;
  }
}

function middleOf(element: ElementLike): { x: number; y: number } {
  const { waypoints } = element as { waypoints?: { x: number; y: number }[] };
  const middle = waypoints?.[Math.floor(waypoints.length / 2)];
  if (middle !== undefined) return middle;
  const { x, y, width, height } = element as unknown as { x: number; y: number; width: number; height: number };
  return { x: x + width / 2, y: y + height / 2 };
}

function rowOf(badges: readonly Badge[], width: number): HTMLElement {
  const row = document.createElement("div");
  row.className = "diagram__badges";
  if (width > 0) row.style.width = `${width}px`;
  for (const badge of badges) {
    const one = document.createElement("span");
    one.className = `diagram__badge diagram__badge--${badge.kind}`;
    one.title = badge.title;
    one.textContent = [SIGNS[badge.kind], badge.text].filter((part) => part !== "").join(" ");
    row.append(one);
  }
  return row;
}
