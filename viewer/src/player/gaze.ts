/** What the camera looks at, and how much of it must be seen. */

import * as THREE from "three";
import type { Cast } from "./cast";
import type { CameraMode, View } from "./view";

/** Height of what is looked at, and half of what must be seen above and below it, metres. */
const EYE = 0.96;
const HALF_HEIGHT = 1.08;

/** Where to look at a moment; null: where the camera looks already. */
export function lookAt(cast: Cast, mode: CameraMode, live: boolean, seconds: number): THREE.Vector3 | null {
  const middle = cast.middle(seconds);
  if (!middle) return new THREE.Vector3(0, EYE, 0);
  if (mode === "follow") return middle.setY(EYE + 0.6 * Math.max(0, middle.y - 1.15));
  const extent = live ? null : cast.extent();
  if (!extent) return null;
  const { low, high } = extent;
  return new THREE.Vector3((low[0] + high[0]) / 2, EYE, (low[1] + high[1]) / 2);
}

/** Bring the camera as near as it can be: to the figures, and where it stands still to their ways. */
export function fit(view: View, cast: Cast, mode: CameraMode, live: boolean): void {
  let half = cast.spread / 2;
  const extent = mode === "orbit" && !live ? cast.extent() : null;
  if (extent) half += Math.hypot(extent.high[0] - extent.low[0], extent.high[1] - extent.low[1]) / 2;
  view.fitBox(half + 0.62, HALF_HEIGHT + 0.12 * half);
}
