/**
 * The timeline: up to eight prompts one after the other, as blocks whose right edges are dragged, or moved by arrow
 * keys. A prompt without seconds of its own is as long as the model thinks it takes.
 */
import { clock, icon, make } from "./dom";

export interface Entry {
  text: string;
  /** Chosen length, or null for the model's. */
  seconds: number | null;
  /** How long it became when it was last made. */
  made: number | null;
}

export interface TimelineEvents {
  /** Another entry is being edited. */
  selected(): void;
  /** A length was changed to stay: the end of a drag, or a key. */
  changed(): void;
  /** The number of entries changed. */
  counted(): void;
  /** The last block but one was removed by a key, and with the blocks went the focus. */
  alone(): void;
}

export const MOST_ENTRIES = 8;
const GUESS_SECONDS = 4;
const STEP = 0.1;
const BIG_STEP = 1;
/** No block so short that it cannot be grasped: pixels. */
const NARROWEST = 46;

export class Timeline {
  entries: Entry[] = [blank()];
  selected = 0;
  private minimum = 0.5;
  private maximum = 60;
  private scale = 40;
  private dragging = false;
  private readonly track = make("div", { class: "track" });
  private readonly head = make("div", { class: "head", "aria-hidden": "true" });

  constructor(
    private readonly root: HTMLElement,
    private readonly events: TimelineEvents,
  ) {
    root.append(this.track);
    // Being hidden is a change of size, too: live mode hides a timeline that has blocks.
    new ResizeObserver(() => !root.hidden && this.draw()).observe(root);
  }

  /** Shortest and longest clip of the model in use, seconds. */
  limit(minimum: number, maximum: number): void {
    [this.minimum, this.maximum] = [minimum, maximum];
  }

  get current(): Entry {
    return this.entries[this.selected];
  }

  /** Replace everything by what was made before, or by one empty prompt. */
  load(entries: Entry[]): void {
    this.entries = entries.length ? entries : [blank()];
    this.selected = 0;
    this.draw();
    this.events.counted();
  }

  /** A new prompt behind the current one; false where there are eight already. */
  add(text = ""): boolean {
    if (this.entries.length >= MOST_ENTRIES) return false;
    this.entries.splice(this.selected + 1, 0, { ...blank(), text });
    this.select(this.selected + 1);
    this.events.counted();
    return true;
  }

  remove(at: number): void {
    if (this.entries.length === 1) return;
    this.entries.splice(at, 1);
    this.select(Math.min(at <= this.selected ? Math.max(0, this.selected - 1) : this.selected, this.entries.length - 1));
    this.events.counted();
  }

  select(at: number): void {
    this.selected = at;
    this.draw();
    this.track.children[at]?.scrollIntoView({ inline: "nearest", block: "nearest" });
    this.events.selected();
  }

  /** Seconds that a block stands for. */
  seconds(entry: Entry): number {
    return entry.seconds ?? entry.made ?? GUESS_SECONDS;
  }

  get total(): number {
    return this.entries.reduce((sum, entry) => sum + this.seconds(entry), 0);
  }

  /** Where the player is: which entry, and how far into it (0 to 1); null hides the mark. */
  playing(at: { entry: number; share: number } | null): void {
    this.head.hidden = at === null;
    this.track.querySelectorAll(".block").forEach((block, k) => block.classList.toggle("now", k === at?.entry));
    if (!at) return;
    const block = this.track.children[at.entry] as HTMLElement | undefined;
    if (block) this.head.style.transform = `translateX(${block.offsetLeft + at.share * block.offsetWidth}px)`;
  }

  /** Draw all blocks. The scale is fixed while an edge is dragged, so that the edge stays under the pointer. */
  draw(): void {
    this.root.hidden = this.entries.length < 2;
    if (this.root.hidden) return;
    const room = Math.max(240, this.root.clientWidth);
    if (!this.dragging) this.scale = Math.max(30, (room - 14) / Math.max(6, this.total));
    const blocks = this.entries.map((entry, k) => this.block(entry, k));
    const focused = (document.activeElement as HTMLElement | null)?.dataset;
    this.track.replaceChildren(...blocks, this.head);
    for (const part of ["handle", "words"]) {
      const k = focused?.[part];
      if (k !== undefined) this.track.querySelector<HTMLElement>(`[data-${part}="${k}"]`)?.focus();
    }
  }

  private block(entry: Entry, k: number): HTMLElement {
    const seconds = this.seconds(entry);
    const text = entry.text || "…";
    const length = make("span", { class: "length" }, entry.seconds === null ? `${clock(seconds)} auto` : clock(seconds));
    const choose = make(
      "button",
      { type: "button", class: "words", "data-words": k, "aria-pressed": String(k === this.selected), title: text },
      make("span", { class: "text" }, text),
      length,
    );
    choose.addEventListener("click", () => this.select(k));
    choose.addEventListener("keydown", (event) => {
      if (event.key === "Delete" || event.key === "Backspace") {
        event.preventDefault();
        this.remove(k);
        if (this.root.hidden) this.events.alone();
        else (this.track.querySelector('[aria-pressed="true"]') as HTMLElement | null)?.focus();
      }
    });
    const remove = make("button", { type: "button", class: "remove", "aria-label": `Remove “${text}”`, tabindex: -1 }, icon("close"));
    remove.addEventListener("click", () => this.remove(k));
    const block = make("div", { class: "block" }, choose, remove, this.handle(entry, k));
    if (k === this.selected) block.classList.add("chosen");
    block.style.width = `${Math.max(NARROWEST, seconds * this.scale)}px`;
    return block;
  }

  private handle(entry: Entry, k: number): HTMLElement {
    const seconds = this.seconds(entry);
    const handle = make("div", {
      class: "edge",
      role: "slider",
      tabindex: 0,
      "data-handle": k,
      "aria-label": `Length of “${entry.text || "…"}”`,
      "aria-orientation": "horizontal",
      "aria-valuemin": this.minimum,
      "aria-valuemax": this.maximum,
      "aria-valuenow": seconds.toFixed(1),
      "aria-valuetext": `${clock(seconds)}${entry.seconds === null ? ", as the model thinks" : ""}`,
      title: "Drag, or use the arrow keys; double click for automatic",
    });
    handle.addEventListener("pointerdown", (event) => this.drag(event, handle, entry, k));
    handle.addEventListener("dblclick", () => this.set(entry, null));
    handle.addEventListener("keydown", (event) => {
      const step = (event.shiftKey ? BIG_STEP : STEP) * ({ ArrowRight: 1, ArrowUp: 1, ArrowLeft: -1, ArrowDown: -1 }[event.key] ?? 0);
      const wanted =
        event.key === "Home" ? this.minimum : event.key === "End" ? this.maximum : step ? this.seconds(entry) + step : undefined;
      if (event.key === "Delete") this.set(entry, null);
      else if (wanted !== undefined) this.set(entry, wanted);
      else return;
      event.preventDefault();
    });
    return handle;
  }

  private set(entry: Entry, seconds: number | null): void {
    entry.seconds = seconds === null ? null : this.allowed(seconds);
    this.draw();
    this.events.changed();
  }

  private allowed(seconds: number): number {
    return Math.round(Math.min(this.maximum, Math.max(this.minimum, seconds)) * 10) / 10;
  }

  private drag(event: PointerEvent, handle: HTMLElement, entry: Entry, k: number): void {
    if (event.button !== 0) return;
    event.preventDefault();
    handle.focus();
    const begun = { x: event.clientX, seconds: this.seconds(entry), own: entry.seconds };
    let moved = false;
    this.dragging = true;
    this.root.classList.add("dragging");
    // Blocks are drawn anew while the pointer moves, so it is followed on the window, not on the edge.
    const move = (at: PointerEvent): void => {
      if (at.pointerId !== event.pointerId || Math.abs(at.clientX - begun.x) < 2) return;
      moved = true;
      entry.seconds = this.allowed(begun.seconds + (at.clientX - begun.x) / this.scale);
      this.draw();
    };
    const end = (at: PointerEvent): void => {
      if (at.pointerId !== event.pointerId) return;
      window.removeEventListener("pointermove", move);
      window.removeEventListener("pointerup", end);
      window.removeEventListener("pointercancel", end);
      this.dragging = false;
      this.root.classList.remove("dragging");
      // A press alone leaves the edge where it is: a second one makes a double click only on the same element.
      if (!moved) return;
      this.draw();
      this.track.querySelector<HTMLElement>(`[data-handle="${k}"]`)?.focus();
      if (entry.seconds !== begun.own) this.events.changed();
    };
    window.addEventListener("pointermove", move);
    window.addEventListener("pointerup", end);
    window.addEventListener("pointercancel", end);
  }
}

function blank(): Entry {
  return { text: "", seconds: null, made: null };
}
