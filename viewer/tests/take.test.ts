import { describe, expect, it } from "vitest";
import { Skeleton } from "../src/skeleton";
import { Take } from "../src/take";
import { parsePackets, WireError } from "../src/wire";
import { ARM, bytesOf, QUARTER, STILL } from "./packets";

const arm = new Skeleton(ARM);
const row = (x: number, root: number[], child = STILL) => [x, 0, 0, ...root, ...child];

function near(actual: ArrayLike<number>, wanted: number[]): void {
  expect(actual.length).toBe(wanted.length);
  wanted.forEach((value, k) => expect(actual[k]).toBeCloseTo(value, 6));
}

describe("Skeleton", () => {
  it("turns children about their parents", () => {
    const take = Take.from(arm, bytesOf([row(5, STILL), row(5, QUARTER)]));
    near(take.positions(0), [5, 0, 0, 5, 1, 0]);
    near(take.positions(1), [5, 0, 0, 4, 0, 0]);
  });

  it("multiplies rotations parent first", () => {
    const x = [Math.SQRT1_2, 0, 0, Math.SQRT1_2];
    const pose = { positions: new Float32Array(6), rotations: new Float32Array(8) };
    Take.from(arm, bytesOf([row(0, QUARTER, x)])).pose(0, pose);
    near(pose.rotations.subarray(4), [0.5, 0.5, 0.5, 0.5]);
  });

  it("refuses what is not a tree", () => {
    expect(() => new Skeleton({ ...ARM, parents: [-1, 1] })).toThrow("not a tree");
    expect(() => new Skeleton({ ...ARM, parents: [-1] })).toThrow("not a tree");
  });
});

describe("Take", () => {
  it("lies on the arc between two frames", () => {
    const take = Take.from(arm, bytesOf([row(0, STILL), row(1, QUARTER)]));
    near(take.positions(0.5), [0.5, 0, 0, 0.5 - Math.SQRT1_2, Math.SQRT1_2, 0]);
    near(take.positions(-3), [0, 0, 0, 0, 1, 0]);
    near(take.positions(99), [1, 0, 0, 0, 0, 0]);
  });

  it("takes the shorter arc where a quaternion changed its sign", () => {
    const take = Take.from(arm, bytesOf([row(0, QUARTER), row(0, QUARTER.map((v) => -v))]));
    near(take.positions(0.5), [0, 0, 0, -1, 0, 0]);
  });

  it("grows", () => {
    const take = new Take(arm);
    for (let first = 0; first < 300; first += 3) {
      const rows = [0, 1, 2].map((k) => row(first + k, STILL));
      take.append(parsePackets(bytesOf(rows, { first, contacts: rows.map(() => [first === 0 ? 1 : 0, 0, 0, 1]) }))[0]);
    }
    expect(take.frames).toBe(300);
    expect(take.seconds).toBeCloseTo(299 / 20);
    expect(take.root(271)[0]).toBe(271);
    expect(take.allRows().length).toBe(300 * 11);
    expect([take.contacts(2), take.contacts(3)]).toEqual([[true, false, false, true], [false, false, false, true]]);
  });

  it("is copied however long a stream was, and goes on by itself", () => {
    const take = new Take(arm);
    const [frames, latencyMs] = [600_000, 0];
    for (const firstFrame of [0, frames]) {
      const contacts = new Uint8Array(4 * frames).fill(1);
      take.append({ joints: 2, frames, firstFrame, fps: 20, latencyMs, rows: new Float32Array(11 * frames), contacts });
    }
    const copy = take.copy();
    take.truncate(1);
    expect([copy.frames, copy.fps, copy.seconds]).toEqual([2 * frames, 20, (2 * frames - 1) / 20]);
    expect(copy.contacts(2 * frames - 1)).toEqual([true, true, true, true]);
    copy.append(parsePackets(bytesOf([row(7, STILL)], { first: 2 * frames }))[0]);
    expect(copy.root(2 * frames)[0]).toBe(7);
  });

  it("refuses frames that do not follow", () => {
    const take = Take.from(arm, bytesOf([row(0, STILL)]));
    const packet = (options: object) => parsePackets(bytesOf([row(0, STILL)], options))[0];
    expect(() => take.append(packet({ first: 0 }))).toThrow(WireError);
    expect(() => take.append(packet({ first: 2 }))).toThrow(WireError);
    expect(() => take.append(packet({ first: 1, fps: 30 }))).toThrow(WireError);
    expect(() => take.append(parsePackets(bytesOf([[0, 0, 0, ...STILL]], { first: 1 }))[0])).toThrow(WireError);
    expect(() => Take.from(arm, new Uint8Array())).toThrow(WireError);
  });

  it("judges planted feet by height and speed", () => {
    const foot = new Skeleton({ ...ARM, feet: [0, 0, 1, 1] });
    const take = Take.from(foot, bytesOf([row(0, STILL), row(0.02, STILL), row(0.2, STILL)]));
    expect(take.contacts(0)).toEqual([true, true, false, false]);
    expect(take.contacts(1)).toEqual([false, false, false, false]);
    expect(take.contacts(2)).toEqual([false, false, false, false]);
  });
});
