/** The way of the root over the ground: a ribbon, faint where the figure has not been yet. */

import * as THREE from "three";
import type { Take } from "../take";
import type { Theme } from "./theme";

const WIDTH = 0.022;
/** Frames on either side of the present that are drawn: an endless stream must not grow without end. */
const MEMORY = 3000;

export class Trail {
  readonly group = new THREE.Group();
  private readonly past: THREE.Mesh;
  private readonly future: THREE.Mesh;
  private readonly geometry = new THREE.BufferGeometry();
  private drawn = { from: 0, to: 0, revision: 0 };

  constructor() {
    const ribbon = (opacity: number) => {
      const material = new THREE.MeshBasicMaterial({ transparent: true, opacity, depthWrite: false, side: THREE.DoubleSide });
      // Two meshes on one geometry would share its draw range: each gets a view of the same attributes.
      const mesh = new THREE.Mesh(new THREE.BufferGeometry(), material);
      mesh.frustumCulled = false;
      mesh.renderOrder = 2;
      this.group.add(mesh);
      return mesh;
    };
    this.past = ribbon(0.85);
    this.future = ribbon(0.22);
  }

  paint(theme: Theme): void {
    for (const mesh of [this.past, this.future]) (mesh.material as THREE.MeshBasicMaterial).color.set(theme.trail);
  }

  update(take: Take, frame: number): void {
    const now = Math.floor(frame);
    const outside = now < this.drawn.from || now > this.drawn.to;
    if (outside || (take.revision !== this.drawn.revision && this.drawn.to - now < MEMORY)) this.lay(take, now);
    const here = Math.max(0, Math.min(now, this.drawn.to) - this.drawn.from);
    this.past.geometry.setDrawRange(0, 6 * here);
    this.future.geometry.setDrawRange(6 * here, Infinity);
  }

  private lay(take: Take, now: number): void {
    const [from, to] = [Math.max(0, now - MEMORY), Math.min(take.frames, now + MEMORY)];
    const points = Array.from({ length: to - from }, (_, k) => take.root(from + k));
    const positions = new Float32Array(6 * points.length);
    let [nx, nz] = [1, 0];
    points.forEach(([x, , z], k) => {
      const [before, after] = [points[Math.max(k - 1, 0)], points[Math.min(k + 1, points.length - 1)]];
      const [dx, dz] = [after[0] - before[0], after[2] - before[2]];
      const step = Math.hypot(dx, dz);
      // Across the way; where the figure stands still, as it was before.
      if (step > 1e-4) [nx, nz] = [(-dz / step) * WIDTH * 0.5, (dx / step) * WIDTH * 0.5];
      else if (k === 0) [nx, nz] = [WIDTH * 0.5, 0];
      positions.set([x + nx, 0.005, z + nz, x - nx, 0.005, z - nz], 6 * k);
    });
    const index: number[] = [];
    for (let k = 0; k + 1 < points.length; k++) {
      const at = 2 * k;
      index.push(at, at + 1, at + 2, at + 1, at + 3, at + 2);
    }
    this.geometry.setAttribute("position", new THREE.BufferAttribute(positions, 3));
    for (const mesh of [this.past, this.future]) {
      mesh.geometry.dispose();
      mesh.geometry = new THREE.BufferGeometry();
      mesh.geometry.setAttribute("position", this.geometry.getAttribute("position"));
      mesh.geometry.setIndex(index);
    }
    this.drawn = { from, to, revision: take.revision };
  }

  dispose(): void {
    for (const mesh of [this.past, this.future]) {
      mesh.geometry.dispose();
      (mesh.material as THREE.Material).dispose();
    }
    this.geometry.dispose();
  }
}
