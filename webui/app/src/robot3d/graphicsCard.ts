/** Whether the browser draws WebGL on a graphics card, or in software on the processor. */

/** Names of renderers without a graphics card: of Chromium, Mesa and Windows. */
const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;

let known: boolean | null = null;

/** Return whether pictures are drawn in software; true as well where the browser does not say it. */
export function drawsInSoftware(): boolean {
  known ??= probed();
  return known;
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
