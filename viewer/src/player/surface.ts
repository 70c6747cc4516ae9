/** What a canvas is drawn with: a graphics card, or a processor in its place. */

import * as THREE from "three";

export interface Surface {
  renderer: THREE.WebGLRenderer;
  /** Drawn by a processor: every triangle and every sample of a pixel is paid for. */
  software: boolean;
}

/** A renderer for the canvas; throws where the browser has no WebGL 2. */
export function openSurface(canvas: HTMLCanvasElement): Surface {
  const software = drawsInSoftware();
  const options = { canvas, antialias: !software, powerPreference: "high-performance" } as const;
  return { renderer: new THREE.WebGLRenderer(options), software };
}

const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;

/** Asked of a context of its own: whether edges are smoothed is settled when a context is made. */
function drawsInSoftware(): boolean {
  const gl = document.createElement("canvas").getContext("webgl2");
  if (!gl) return false;
  const named = gl.getExtension("WEBGL_debug_renderer_info");
  const name = String(gl.getParameter(named ? named.UNMASKED_RENDERER_WEBGL : gl.RENDERER));
  gl.getExtension("WEBGL_lose_context")?.loseContext();
  return SOFTWARE.test(name);
}
