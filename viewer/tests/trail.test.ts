import { expect, test } from "vitest";
import type { Mesh } from "three";
import { Trail } from "../src/player/trail";
import { Skeleton } from "../src/skeleton";
import { Take } from "../src/take";

const skeleton = new Skeleton({ name: "one", joints: ["root"], parents: [-1], offsets: [[0, 0, 0]], feet: [] });

function ahead(take: Take, frames: number, along: (k: number) => [number, number]): void {
  const rows = Float32Array.from({ length: frames }, (_, k) => k).reduce<number[]>((all, k) => {
    const [x, z] = along(take.frames + k);
    return [...all, x, 1, z, 0, 0, 0, 1];
  }, []);
  take.append({ joints: 1, frames, firstFrame: take.frames, fps: 20, latencyMs: 0, rows: Float32Array.from(rows), contacts: null });
}

test("frames that come once more, as many as there were, are where the way leads", () => {
  const take = new Take(skeleton);
  ahead(take, 40, (k) => [0, 0.1 * k]);
  const trail = new Trail();
  trail.update(take, 5);
  take.truncate(20);
  ahead(take, 20, (k) => [0.1 * (k - 20), 2]);
  trail.update(take, 6);
  const places = (trail.group.children[1] as Mesh).geometry.getAttribute("position");
  expect(places.getX(2 * 39)).toBeCloseTo(1.9, 1);
});
