import { describe, expect, it } from "vitest";
import { RATIOS, Sharpness } from "../src/player/sharpness";

const COARSEST = RATIOS[RATIOS.length - 1];

/** Plays for some milliseconds where `cost` says what a picture takes; the ratio after each picture. */
function play(sharpness: Sharpness, ms: number, full: number, cost: (ratio: number) => number): number[] {
  const seen: number[] = [];
  for (let at = 0; at < ms; ) {
    const took = cost(sharpness.ratio(full));
    sharpness.moved(took, full);
    seen.push(sharpness.ratio(full));
    at += took;
  }
  return seen;
}

/** A screen of 60 Hz: pictures come at its beat, or miss some. */
const beat = (ms: number) => Math.ceil(ms / 16.7) * 16.7;
const changes = (seen: number[]) => seen.filter((ratio, k) => k > 0 && ratio !== seen[k - 1]).length;

describe("Sharpness", () => {
  it("leaves a picture alone that keeps up", () => {
    expect(new Set(play(new Sharpness(), 20_000, 2, () => 16.7))).toEqual(new Set([2]));
    expect(new Set(play(new Sharpness(), 20_000, 1, () => 8.3))).toEqual(new Set([1]));
  });

  it("lowers within two or three seconds until the picture keeps up, and stays there", () => {
    const sharpness = new Sharpness();
    const seen = play(sharpness, 60_000, 1, (ratio) => 24 * ratio * ratio);
    expect(sharpness.ratio(1)).toBe(0.8);
    expect(seen.indexOf(0.8)).toBeLessThan(60);
  });

  it("begins to lower only when it was slow for half a second", () => {
    const seen = play(new Sharpness(), 490, 1, () => 30);
    expect(new Set(seen.slice(0, -1))).toEqual(new Set([1]));
    expect(play(new Sharpness(), 600, 1, () => 30).pop()).toBeLessThan(1);
  });

  it("takes one long pause for what it is", () => {
    let pictures = 0;
    expect(new Set(play(new Sharpness(), 20_000, 1, () => (pictures++ % 25 === 24 ? 400 : 16.7)))).toEqual(new Set([1]));
  });

  it("never goes below the coarsest", () => {
    const seen = play(new Sharpness(), 30_000, 2, (ratio) => 1000 * ratio * ratio);
    expect(Math.min(...seen)).toBe(COARSEST);
    expect(seen.pop()).toBe(COARSEST);
  });

  it("raises again when there is room, one step at a time", () => {
    const sharpness = new Sharpness();
    play(sharpness, 10_000, 1, (ratio) => beat(60 * ratio * ratio));
    expect(sharpness.ratio(1)).toBe(COARSEST);
    const seen = play(sharpness, 60_000, 1, () => 16.7);
    expect(seen.pop()).toBe(1);
    expect([...new Set(seen)]).toEqual([0.5, 0.64, 0.8, 1]);
  });

  it("tries more pixels ever more rarely where they do not fit", () => {
    const sharpness = new Sharpness();
    const cost = (ratio: number) => beat(20 * ratio * ratio);
    const minutes = Array.from({ length: 8 }, () => changes(play(sharpness, 60_000, 1, cost)));
    expect(minutes[0]).toBeGreaterThan(2);
    expect(minutes[0]).toBeLessThan(14);
    for (const count of minutes.slice(3)) expect(count).toBeLessThanOrEqual(2);
  });

  it("gives the pixels back where they are not what is slow", () => {
    const sharpness = new Sharpness();
    const seen = play(sharpness, 25_000, 1, () => 33.3);
    expect(Math.min(...seen)).toBe(COARSEST);
    expect(seen.pop()).toBe(1);
    expect(seen.filter((ratio) => ratio < 1).length).toBeLessThan(0.2 * seen.length);
  });

  it("begins where it is told, and goes up from there", () => {
    const sharpness = new Sharpness(1);
    expect(sharpness.ratio(1.6)).toBe(1);
    expect(sharpness.ratio(0.9)).toBe(0.9);
    expect(play(sharpness, 20_000, 1.6, () => 16.7).pop()).toBe(1.6);
  });

  it("forgets a span that was cut short", () => {
    const sharpness = new Sharpness();
    for (let k = 0; k < 20; k++) {
      play(sharpness, 400, 1, () => 100);
      sharpness.forget();
    }
    expect(sharpness.ratio(1)).toBe(1);
  });
});
