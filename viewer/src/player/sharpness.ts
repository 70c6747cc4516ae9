/** How many pixels a picture may have: fewer where drawing cannot keep up, more again where there is room. */

/** Pixels to a CSS pixel, from fine to coarse. */
export const RATIOS = [2, 1.6, 1.25, 1, 0.8, 0.64, 0.5] as const;
/** Milliseconds between two pictures above which there are too many pixels, and below which there may be room for more. */
const SLOW = 20;
const ROOMY = 17.5;
/** Milliseconds, and pictures, that are judged together. */
const SPAN = 500;
const LEAST = 4;
/** Milliseconds without haste before more pixels are tried; doubled with each try that failed. */
const PATIENCE = 2000;
const LONGEST = 64_000;
/** Part of the time that must be left at the coarsest for it to be worth its looks; milliseconds until it is tried again. */
const WORTH = 0.9;
const REST = 30_000;

export class Sharpness {
  private readonly times: number[] = [];
  private sum = 0;
  private calm = 0;
  private patience = PATIENCE;
  private resting = 0;
  /** Whether the present limit was tried upwards. */
  private raised = false;
  /** Limit and time between pictures when it first became too slow. */
  private before: { limit: number; time: number } | null = null;

  /** `limit`: pixels to a CSS pixel to begin with, while the picture moves. */
  constructor(private limit = Infinity) {}

  /** Pixels to a CSS pixel while the picture moves, of at most `full`. */
  ratio(full: number): number {
    return Math.min(this.limit, full);
  }

  /** A moving picture came `since` milliseconds after the one before; `full` is what a still one has. */
  moved(since: number, full: number): void {
    this.times.push(since);
    this.sum += since;
    if (this.sum < SPAN || this.times.length < LEAST) return;
    // The median: one long pause, of a collector or of a shader being compiled, says nothing about pixels.
    const time = this.times.sort((a, b) => a - b)[this.times.length >> 1];
    const span = this.sum;
    this.forget();
    this.resting = Math.max(0, this.resting - span);
    if (time > SLOW) this.lower(time, full);
    else {
      this.before = null;
      this.calm = time < ROOMY ? this.calm + span : 0;
      if (this.calm >= this.patience) this.raise(full);
    }
  }

  /** The picture stands still: what was measured so far is no part of what comes. */
  forget(): void {
    this.times.length = 0;
    this.sum = 0;
  }

  private lower(time: number, full: number): void {
    this.calm = 0;
    if (this.raised) this.patience = Math.min(2 * this.patience, LONGEST);
    this.raised = false;
    if (this.resting > 0) return;
    const now = this.ratio(full);
    this.before ??= { limit: now, time };
    const coarser = RATIOS.filter((ratio) => ratio < now - 0.01);
    if (coarser.length > 0) {
      // Two steps at once where half the pictures are missing.
      this.limit = coarser[time > 2 * SLOW && coarser.length > 1 ? 1 : 0];
    } else if (now < this.before.limit && time > WORTH * this.before.time) {
      // A slow screen, or a busy page: it is not the pixels, and they can as well be there.
      this.limit = this.before.limit;
      this.before = null;
      this.resting = REST;
    }
  }

  private raise(full: number): void {
    this.calm = 0;
    const finer = RATIOS.findLast((ratio) => ratio > this.limit + 0.01);
    if (this.limit >= full) return;
    this.limit = finer ?? Infinity;
    this.raised = true;
  }
}
