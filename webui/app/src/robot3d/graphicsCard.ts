/** Whether the browser draws WebGL on a graphics card, or in software on the processor. */

/** Names of renderers without a graphics card: of Chromium, Mesa and Windows. */
const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;

/** The shortest time between two pictures that are drawn in software: 20 a second. */
const SOFTWARE_PERIOD_MS = 48;

let known: boolean | null = null;

/** Return whether pictures are drawn in software; true as well where the browser does not say it. */
export function drawsInSoftware(): boolean {
  known ??= probed();
  return known;
}

/** Return the shortest time between two pictures in ms, so that the processor has time for other work. */
export function picturePeriodMs(): number {
  return drawsInSoftware() ? SOFTWARE_PERIOD_MS : 0;
}

/** Return whether a renderer of this name draws in software. */
export function isSoftware(renderer: string): boolean {
  return SOFTWARE.test(renderer);
}

function probed(): boolean {
  const gl = document.createElement("canvas").getContext("webgl2");
  if (gl === null) return true;
  const names = gl.getExtension("WEBGL_debug_renderer_info");
  const renderer: unknown = gl.getParameter(names === null ? gl.RENDERER : names.UNMASKED_RENDERER_WEBGL);
  gl.getExtension("WEBGL_lose_context")?.loseContext();
  return typeof renderer !== "string" || isSoftware(renderer);
}
