/** How long the last pictures took, for whoever asks. */

/** How many are remembered. */
const MEASURED = 240;

export class Meter {
  private readonly intervals: number[] = [];
  private readonly work: number[] = [];

  /** A picture took `work` ms of this page, and came `since` ms after the one before; 0 where there was none. */
  drawn(work: number, since: number): void {
    remember(this.work, work);
    if (since > 0) remember(this.intervals, since);
  }

  /** The last pictures' distances in time and the time spent on each by this page, milliseconds. */
  times(): { interval: number[]; work: number[] } {
    return { interval: [...this.intervals], work: [...this.work] };
  }
}

function remember(values: number[], value: number): void {
  values.push(value);
  if (values.length > MEASURED) values.shift();
}
