/** Where the camera is: turned and zoomed by hand, around a fixed place or around the figures. */

import * as THREE from "three";

export type CameraMode = "orbit" | "follow";

const PITCH = [-0.05, 1.45] as const;
const START = { yaw: 0.62, pitch: 0.2 };

export class View {
  /** Radians around the vertical, from +Z, and above the horizon. */
  yaw = START.yaw;
  pitch = START.pitch;
  /** Times the distance that fits the figures. */
  zoom = 1;
  fit = 5;
  /** Part of the picture's height that nothing lies over. */
  free = 1;
  readonly target = new THREE.Vector3(0, 0.92, 0);
  /** How far the view was moved sideways by hand, metres. */
  readonly shift = new THREE.Vector3();
  private readonly pointers = new Map<number, { x: number; y: number }>();
  private readonly stop = new AbortController();

  constructor(
    private readonly camera: THREE.PerspectiveCamera,
    private readonly surface: HTMLElement,
    private readonly changed: () => void,
  ) {
    const options = { signal: this.stop.signal };
    surface.addEventListener("pointerdown", (event) => this.down(event), options);
    surface.addEventListener("pointermove", (event) => this.move(event), options);
    for (const name of ["pointerup", "pointercancel", "lostpointercapture"] as const) {
      surface.addEventListener(name, (event) => this.pointers.delete(event.pointerId), options);
    }
    surface.addEventListener("wheel", (event) => this.wheel(event), { ...options, passive: false });
    surface.addEventListener("dblclick", () => this.reset(), options);
    // The right button moves the view; a menu over it would end that.
    surface.addEventListener("contextmenu", (event) => event.preventDefault(), options);
  }

  reset(): void {
    this.yaw = START.yaw;
    this.pitch = START.pitch;
    this.zoom = 1;
    this.shift.set(0, 0, 0);
    this.changed();
  }

  turn(yaw: number, pitch: number): void {
    this.yaw += yaw;
    this.pitch = Math.min(Math.max(this.pitch + pitch, PITCH[0]), PITCH[1]);
    this.changed();
  }

  zoomBy(factor: number): void {
    this.zoom = Math.min(Math.max(this.zoom * factor, 0.25), 5);
    this.changed();
  }

  /** Distance at which a box of these half sizes, seen at any angle, fits the picture. */
  fitBox(halfWidth: number, halfHeight: number): void {
    const up = Math.tan(THREE.MathUtils.degToRad(this.camera.fov) / 2);
    const across = up * this.camera.aspect;
    this.fit = Math.max(halfHeight / (up * this.free), halfWidth / across) + Math.min(halfWidth, 0.5);
  }

  /** Look at another place, at once or smoothly within `seconds`; whether anything moved. */
  aim(wanted: THREE.Vector3, atOnce: boolean, seconds: number): boolean {
    const away = this.target.distanceTo(wanted);
    if (atOnce || away > 2.5) this.target.copy(wanted);
    else if (away > 1e-3) this.target.lerp(wanted, 1 - Math.exp(-7 * Math.min(seconds, 0.25)));
    else return false;
    return true;
  }

  /** Put the camera where it belongs. */
  apply(): void {
    const distance = this.fit * this.zoom;
    const level = Math.cos(this.pitch) * distance;
    const { camera } = this;
    camera.position.set(Math.sin(this.yaw) * level, Math.sin(this.pitch) * distance, Math.cos(this.yaw) * level);
    camera.position.add(this.target).add(this.shift);
    camera.position.y = Math.max(camera.position.y, 0.06);
    camera.lookAt(this.target.x + this.shift.x, this.target.y + this.shift.y, this.target.z + this.shift.z);
    camera.updateMatrixWorld();
  }

  private down(event: PointerEvent): void {
    this.surface.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  }

  private move(event: PointerEvent): void {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const now = { x: event.clientX, y: event.clientY };
    const others = [...this.pointers].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
    const [dx, dy] = [now.x - before.x, now.y - before.y];
    if (others.length > 0) {
      const other = others[0];
      this.zoomBy(Math.hypot(before.x - other.x, before.y - other.y) / Math.max(1, Math.hypot(now.x - other.x, now.y - other.y)));
      this.pan(dx / 2, dy / 2);
    } else if (event.shiftKey || (event.buttons & 6) !== 0) {
      this.pan(dx, dy);
    } else {
      const full = Math.max(200, this.surface.clientHeight);
      this.turn((-dx * 3.2) / full, (dy * 2.4) / full);
    }
    this.pointers.set(event.pointerId, now);
  }

  /** Move the view by pixels. */
  private pan(dx: number, dy: number): void {
    const size = (2 * Math.tan(THREE.MathUtils.degToRad(this.camera.fov) / 2) * this.fit * this.zoom) / this.surface.clientHeight;
    const right = new THREE.Vector3().setFromMatrixColumn(this.camera.matrixWorld, 0);
    const up = new THREE.Vector3().setFromMatrixColumn(this.camera.matrixWorld, 1);
    this.shift.addScaledVector(right, -dx * size).addScaledVector(up, dy * size).clampLength(0, 30);
    this.changed();
  }

  private wheel(event: WheelEvent): void {
    event.preventDefault();
    this.zoomBy(Math.exp(Math.min(Math.max(event.deltaY, -120), 120) * 0.0016));
  }

  dispose(): void {
    this.stop.abort();
  }
}
