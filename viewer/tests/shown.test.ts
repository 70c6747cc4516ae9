import { describe, expect, it } from "vitest";
import { Skeleton } from "../src/skeleton";
import { firstThatFits, packets } from "../src/studio/shown";
import { Take } from "../src/take";
import { ARM, bytesOf, STILL } from "./packets";

const FRAMES = 100;
const rows = Array.from({ length: FRAMES }, (_, x) => [x, 0, 0, ...STILL, ...STILL]);
const contacts = rows.map((_, k) => [k % 2, 0, 0, 1]);
const take = Take.from(new Skeleton(ARM), bytesOf(rows, { contacts }));
const ROOM = { export: 1e6, picture_seconds: 100, frames: 1000 };

describe("firstThatFits", () => {
  it("leaves alone what fits", () => {
    expect(firstThatFits(take, "mp4", 20, ROOM)).toBe(0);
    const exact = packets(take).length;
    expect(firstThatFits(take, "bvh", 20, { ...ROOM, export: exact })).toBe(0);
    expect(firstThatFits(take, "bvh", 20, { ...ROOM, export: exact - 1 })).toBe(1);
  });

  it("keeps the newest bytes, seconds of films, and frames at either rate", () => {
    for (const limit of [500, 1000, 1001]) {
      const first = firstThatFits(take, "bvh", 20, { ...ROOM, export: limit });
      expect(packets(take, first).length).toBeLessThanOrEqual(limit);
      expect(packets(take, first - 1).length).toBeGreaterThan(limit);
    }
    expect(firstThatFits(take, "mp4", 20, { ...ROOM, picture_seconds: 3 })).toBe(40);
    expect(firstThatFits(take, "bvh", 20, { ...ROOM, picture_seconds: 3 })).toBe(0);
    expect(firstThatFits(take, "bvh", 60, { ...ROOM, frames: 120 })).toBe(60);
    expect(firstThatFits(take, "bvh", 10, { ...ROOM, frames: 60 })).toBe(40);
  });
});

describe("packets", () => {
  it("may be of the newest frames alone", () => {
    const rest = Take.from(take.skeleton, packets(take, 97));
    expect([rest.frames, rest.fps, rest.root(0)[0], rest.root(2)[0]]).toEqual([3, 20, 97, 99]);
    expect(rest.contacts(0)).toEqual([true, false, false, true]);
  });
});
