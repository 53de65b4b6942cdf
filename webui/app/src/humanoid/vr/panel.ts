/** A panel of words and buttons in the scene, drawn on a canvas only when it changes. */
import { CanvasTexture, Mesh, MeshBasicMaterial, PlaneGeometry, SRGBColorSpace } from "three";

export interface PanelButton {
  id: string;
  label: string;
}

export interface PanelContent {
  title: string;
  lines: readonly string[];
  /** A pause, a stop or a warning. */
  isWarning: boolean;
  buttons: readonly PanelButton[];
}

const WIDTH_PX = 1280;
const HEIGHT_PX = 640;
const WIDTH_M = 1.3;
const BUTTON_TOP_PX = 510;
const BUTTON_PX = 100;
const GAP_PX = 24;
const PADDING_PX = 40;
/** Read from 1.5 m: 48 px are 49 mm, or 112 minutes of arc; body text of 40 px is 93. */
const FONTS = { title: "600 60px", line: "400 42px", button: "600 38px" };
const COLOURS = { back: "#10161f", text: "#ffffff", quiet: "#c7d0dc", warning: "#ffb020", button: "#2563c9", aimed: "#4d8bef" };

export class Panel {
  readonly mesh: Mesh<PlaneGeometry, MeshBasicMaterial>;
  readonly #canvas = document.createElement("canvas");
  readonly #texture: CanvasTexture;
  #content: PanelContent = { title: "", lines: [], isWarning: false, buttons: [] };
  #aimed: string | null = null;
  #drawn = "";

  constructor() {
    this.#canvas.width = WIDTH_PX;
    this.#canvas.height = HEIGHT_PX;
    this.#texture = new CanvasTexture(this.#canvas);
    this.#texture.colorSpace = SRGBColorSpace;
    this.mesh = new Mesh(new PlaneGeometry(WIDTH_M, (WIDTH_M * HEIGHT_PX) / WIDTH_PX), new MeshBasicMaterial({ map: this.#texture, transparent: true }));
  }

  show(content: PanelContent): void {
    this.#content = content;
    this.#draw();
  }

  /** The button at a place of the panel from (0, 0) to (1, 1), as a ray hits it; it is shown as aimed at. */
  aim(u: number, v: number): string | null {
    const [x, y] = [u * WIDTH_PX, (1 - v) * HEIGHT_PX];
    const found = y < BUTTON_TOP_PX || y > BUTTON_TOP_PX + BUTTON_PX ? undefined : this.#boxes().find(({ left, width }) => x >= left && x <= left + width);
    this.#aim(found?.id ?? null);
    return this.#aimed;
  }

  leave(): void {
    this.#aim(null);
  }

  dispose(): void {
    this.#texture.dispose();
    this.mesh.geometry.dispose();
    this.mesh.material.dispose();
  }

  #aim(id: string | null): void {
    if (id === this.#aimed) return;
    this.#aimed = id;
    this.#draw();
  }

  #boxes(): { id: string; label: string; left: number; width: number }[] {
    const { buttons } = this.#content;
    const width = (WIDTH_PX - 2 * PADDING_PX - (buttons.length - 1) * GAP_PX) / Math.max(buttons.length, 1);
    return buttons.map(({ id, label }, index) => ({ id, label, left: PADDING_PX + index * (width + GAP_PX), width }));
  }

  #draw(): void {
    const key = JSON.stringify([this.#content, this.#aimed]);
    const pen = this.#canvas.getContext("2d");
    if (key === this.#drawn || pen === null) return;
    this.#drawn = key;
    const { title, lines, isWarning } = this.#content;
    const font = getComputedStyle(document.body).fontFamily;
    pen.clearRect(0, 0, WIDTH_PX, HEIGHT_PX);
    pen.fillStyle = COLOURS.back;
    pen.beginPath();
    pen.roundRect(0, 0, WIDTH_PX, HEIGHT_PX, 32);
    pen.fill();
    if (isWarning) {
      pen.lineWidth = 12;
      pen.strokeStyle = COLOURS.warning;
      pen.beginPath();
      pen.roundRect(6, 6, WIDTH_PX - 12, HEIGHT_PX - 12, 28);
      pen.stroke();
    }
    pen.textBaseline = "top";
    pen.font = `${FONTS.title} ${font}`;
    pen.fillStyle = isWarning ? COLOURS.warning : COLOURS.text;
    pen.fillText(title, PADDING_PX, PADDING_PX, WIDTH_PX - 2 * PADDING_PX);
    pen.font = `${FONTS.line} ${font}`;
    pen.fillStyle = COLOURS.quiet;
    const wrapped = lines.flatMap((line) => wrap(pen, line, WIDTH_PX - 2 * PADDING_PX)).slice(0, 6);
    wrapped.forEach((line, index) => pen.fillText(line, PADDING_PX, 130 + index * 60, WIDTH_PX - 2 * PADDING_PX));
    pen.font = `${FONTS.button} ${font}`;
    pen.textBaseline = "middle";
    pen.textAlign = "center";
    for (const { id, label, left, width } of this.#boxes()) {
      pen.fillStyle = id === this.#aimed ? COLOURS.aimed : COLOURS.button;
      pen.beginPath();
      pen.roundRect(left, BUTTON_TOP_PX, width, BUTTON_PX, 20);
      pen.fill();
      pen.fillStyle = COLOURS.text;
      pen.fillText(label, left + width / 2, BUTTON_TOP_PX + BUTTON_PX / 2, width - 20);
    }
    pen.textAlign = "left";
    this.#texture.needsUpdate = true;
  }
}

function wrap(pen: CanvasRenderingContext2D, text: string, width: number): string[] {
  const lines: string[] = [];
  for (const word of text.split(" ")) {
    const longer = lines.length === 0 ? word : `${lines[lines.length - 1] ?? ""} ${word}`;
    if (lines.length > 0 && pen.measureText(longer).width <= width) lines[lines.length - 1] = longer;
    else lines.push(word);
  }
  return lines;
}
