/** Who stands on the stage: takes with their figures, side by side, and their names above their heads. */

import * as THREE from "three";
import { element } from "./dom";
import { Figure, type Overlays } from "./figure";
import type { PlayerTake } from "./options";
import type { Theme } from "./theme";
import type { Take } from "../take";

/** Least and greatest x and z. */
export interface Extent {
  low: [number, number];
  high: [number, number];
}

export class Cast {
  readonly figures: Figure[];
  readonly tags: HTMLElement[];
  /** Metres between the first figure and the last. */
  readonly spread: number;

  /** `coarse`: bodies of fewer triangles. */
  constructor(
    readonly entries: readonly PlayerTake[],
    coarse: boolean,
  ) {
    this.figures = entries.map(({ take }) => new Figure(take, coarse));
    this.tags = entries.length > 1 ? entries.map(({ title }) => element("div", { class: "mv-label" }, title)) : [];
    this.spread = this.arrange();
  }

  /** Side by side, as far apart as the takes move sideways, within reason. */
  private arrange(): number {
    const count = this.figures.length;
    const reach = Math.max(0, ...this.entries.map(({ take }) => sideways(take)));
    const gap = Math.min(Math.max(1.25, 0.9 + reach), 2.4);
    // On screen the first take is on the left; the camera stands on the side that faces see.
    this.figures.forEach((figure, k) => {
      const along = (k - (count - 1) / 2) * gap;
      figure.group.position.set(along * SIDE[0], 0, along * SIDE[1]);
    });
    return (count - 1) * gap;
  }

  get fps(): number {
    return this.entries[0]?.take.fps ?? 20;
  }

  /** Seconds of the longest take. */
  get duration(): number {
    return Math.max(0, ...this.entries.map(({ take }) => take.seconds));
  }

  /** Frames of all takes together. */
  get frames(): number {
    return this.entries.reduce((sum, { take }) => sum + take.frames, 0);
  }

  /** What is to be seen, in words. */
  get described(): string {
    return this.entries.map(({ title }) => title).filter(Boolean).join("; ");
  }

  paint(theme: Theme): void {
    for (const figure of this.figures) figure.paint(theme);
  }

  show(overlays: Overlays): void {
    for (const figure of this.figures) figure.show(overlays);
  }

  /** Everybody as at a moment. */
  update(seconds: number): void {
    for (const figure of this.figures) {
      if (figure.take.frames > 0) figure.update(seconds * figure.take.fps);
    }
  }

  /** The middle of all roots at a moment; null before anybody has a frame. */
  middle(seconds: number): THREE.Vector3 | null {
    const takes = this.entries.map(({ take }) => take).filter((take) => take.frames > 0);
    if (takes.length === 0) return null;
    const mean = new THREE.Vector3();
    for (const take of takes) mean.add(spot.fromArray(take.root(seconds * take.fps)));
    return mean.divideScalar(takes.length);
  }

  /** Where the roots of all takes go; null before anybody has a frame. */
  extent(): Extent | null {
    if (this.frames === 0) return null;
    const [low, high]: [[number, number], [number, number]] = [[Infinity, Infinity], [-Infinity, -Infinity]]; // prettier-ignore
    for (const { take } of this.entries) {
      for (let frame = 0; frame < take.frames; frame += Math.max(1, Math.floor(take.frames / 200))) {
        const [x, , z] = take.root(frame);
        [low[0], low[1]] = [Math.min(low[0], x), Math.min(low[1], z)];
        [high[0], high[1]] = [Math.max(high[0], x), Math.max(high[1], z)];
      }
    }
    return { low, high };
  }

  /** Put the names above the heads, in a picture of this size. */
  placeTags(camera: THREE.Camera, width: number, height: number): void {
    this.tags.forEach((tag, k) => {
      const { group, pose } = this.figures[k];
      const head = Math.max(...pose.positions.filter((_, at) => at % 3 === 1)) + 0.3;
      spot.set(pose.positions[0] + group.position.x, head, pose.positions[2] + group.position.z);
      spot.project(camera);
      const [x, y] = [(0.5 + 0.5 * spot.x) * width, (0.5 - 0.5 * spot.y) * height];
      tag.hidden = spot.z > 1;
      tag.style.transform = `translate(${x.toFixed(1)}px, ${Math.max(y, 4).toFixed(1)}px) translate(-50%, -100%)`;
    });
  }

  dispose(): void {
    for (const figure of this.figures) figure.dispose();
  }
}

/** Direction in which takes stand beside one another: to the right of a camera in its first place. */
const SIDE = [Math.cos(0.62), -Math.sin(0.62)] as const;
const spot = new THREE.Vector3();

/** How far a take's root moves in the direction of its neighbours. */
function sideways(take: Take): number {
  let [low, high] = [0, 0];
  for (let frame = 0; frame < take.frames; frame += 4) {
    const [x, , z] = take.root(frame);
    const along = x * SIDE[0] + z * SIDE[1];
    [low, high] = [Math.min(low, along), Math.max(high, along)];
  }
  return high - low;
}
