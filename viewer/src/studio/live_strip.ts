/**
 * The strip of a stream: time moves to the left under a fixed playhead. Blocks are prompts, placed at the frames at
 * which they take effect; what has been made but not yet played lies to the right of the head.
 */
import { clock, make } from "./dom";
import type { Mark } from "./shown";

/** Pixels of a second, fewer where the strip would show too little, and the share of it left of the head. */
const SECOND = 72;
const SHORTEST = 7;
const HEAD = 0.5;

export class LiveStrip {
  private marks: Mark[] = [];
  private blocks: HTMLElement[] = [];
  private readonly made = make("div", { class: "made" });
  private readonly rail = make("div", { class: "rail" });
  private width = 0;

  constructor(
    private readonly root: HTMLElement,
    private readonly fps: () => number,
  ) {
    const head = make("div", { class: "head" });
    head.style.left = `${100 * HEAD}%`;
    root.append(this.made, this.rail, head);
    root.setAttribute("role", "img");
    new ResizeObserver(() => (this.width = root.clientWidth)).observe(root);
  }

  /** Follow a new list of marks; the list may grow. */
  follow(marks: Mark[]): void {
    this.marks = marks;
    this.blocks = [];
    this.rail.replaceChildren();
  }

  /** Draw the strip with the head at `frame`, and `frames` made so far. */
  draw(frame: number, frames: number): void {
    const pixels = Math.min(SECOND, this.width / SHORTEST) / this.fps();
    const at = (place: number): number => (place - frame) * pixels + this.width * HEAD;
    const begun = Math.max(0, at(0));
    this.made.style.transform = `translateX(${begun}px)`;
    this.made.style.width = `${Math.max(0, at(frames) - begun)}px`;
    for (let k = this.blocks.length; k < this.marks.length; k++) {
      const { text, firstFrame } = this.marks[k];
      const label = make("span", { class: "text" }, text);
      const time = make("span", { class: "length" }, clock(firstFrame / this.fps()));
      const block = make("div", { class: "block", "data-frame": firstFrame }, make("div", { class: "words" }, label, time));
      this.blocks.push(block);
      this.rail.append(block);
    }
    this.marks.forEach((mark, k) => {
      const left = at(mark.firstFrame);
      const end = k + 1 < this.marks.length ? this.marks[k + 1].firstFrame : Math.max(frames, mark.firstFrame + this.fps());
      const right = at(end);
      const block = this.blocks[k];
      block.hidden = right < 0 || left > this.width;
      if (block.hidden) return;
      // A block that began left of the strip keeps its words in sight.
      const seen = Math.max(left, 0);
      block.style.transform = `translateX(${seen}px)`;
      block.style.width = `${Math.max(2, right - seen - 2)}px`;
      block.classList.toggle("begun", left < 0);
      block.classList.toggle("now", frame >= mark.firstFrame && frame < end);
      block.classList.toggle("coming", frame < mark.firstFrame);
    });
    const current = this.marks.findLast((mark) => mark.firstFrame <= frame);
    const label = current ? `Now: ${current.text}` : "Nothing yet";
    if (this.root.getAttribute("aria-label") !== label) this.root.setAttribute("aria-label", label);
  }
}
