/** The bar under the picture. It only shows what the player says, and tells the player what was asked. */

import { clock, element, icon } from "./dom";
import { canRecord } from "./recording";

export const SPEEDS = [0.25, 0.5, 1, 1.5, 2] as const;

export interface Prompt {
  text: string;
  firstFrame: number;
}

/** What the bar shows. */
export interface State {
  playing: boolean;
  live: boolean;
  seconds: number;
  duration: number;
  speed: number;
  loop: boolean;
  follow: boolean;
  skeleton: boolean;
  contacts: boolean;
  trail: boolean;
  recording: boolean;
  dark: boolean;
}

export type Toggle = "playing" | "loop" | "follow" | "skeleton" | "contacts" | "trail" | "recording" | "dark" | "full";

export interface Asked {
  toggle(what: Toggle): void;
  seek(seconds: number): void;
  speed(value: number): void;
}

export class Controls {
  readonly root = element("div", { class: "mv-bar", role: "group", "aria-label": "Playback" });
  private readonly slider = element("input", { type: "range", min: "0", step: "0.001", "aria-label": "Time" });
  private readonly scrub = element("div", { class: "mv-scrub" }, this.slider);
  private readonly time = element("div", { class: "mv-time" });
  private readonly speed = element("select", { class: "mv-speed", "aria-label": "Speed", title: "Speed (arrow up, arrow down)" });
  private readonly toggles = new Map<Toggle, HTMLButtonElement>();
  private marks: HTMLButtonElement[] = [];
  private shown = "";

  constructor(private readonly asked: Asked) {
    const play = this.button("playing", "Play", "space", icon("play"), icon("pause"));
    play.classList.add("mv-play");
    play.removeAttribute("aria-pressed");
    for (const speed of SPEEDS) this.speed.append(element("option", { value: String(speed) }, `${speed}×`));
    const record = this.button("recording", "Record a video", "v", icon("record"));
    record.classList.add("mv-record");
    const gap = () => element("span", { class: "mv-gap" });
    this.root.append(
      play,
      this.scrub,
      this.time,
      this.speed,
      this.button("loop", "Repeat", "l", icon("loop")),
      gap(),
      this.button("follow", "Follow the figure", "f", icon("follow")),
      this.button("skeleton", "Show the skeleton", "s", icon("skeleton")),
      this.button("contacts", "Show planted feet", "c", icon("contacts")),
      this.button("trail", "Show the way", "t", icon("trail")),
      gap(),
      this.button("dark", "Dark colours", "d", icon("theme")),
      record,
    );
    if (!canRecord()) record.remove();
    if (document.fullscreenEnabled) this.root.append(this.button("full", "Full screen", "F", icon("full")));
    this.slider.addEventListener("input", () => asked.seek(Number(this.slider.value)));
    this.speed.addEventListener("change", () => asked.speed(Number(this.speed.value)));
  }

  private button(what: Toggle, name: string, key: string, ...content: Node[]): HTMLButtonElement {
    const attributes = { type: "button", class: "mv-button", title: `${name} (${key})`, "aria-label": name, "aria-pressed": "false" };
    const button = element("button", attributes, ...content);
    button.addEventListener("click", () => this.asked.toggle(what));
    this.toggles.set(what, button);
    return button;
  }

  update(state: State): void {
    this.slider.max = String(Math.max(state.duration, 0.001));
    this.slider.value = String(state.seconds);
    const precise = state.duration < 60;
    const [now, all] = [clock(state.seconds, precise), clock(state.duration, precise)];
    const shown = JSON.stringify({ ...state, seconds: now, duration: all });
    const done = state.duration > 0 ? (100 * state.seconds) / state.duration : 0;
    this.scrub.style.setProperty("--mv-done", `${done.toFixed(2)}%`);
    if (shown === this.shown) return;
    this.shown = shown;
    this.slider.setAttribute("aria-valuetext", `${now} of ${all} seconds`);
    this.time.replaceChildren(element("b", {}, now), ` / ${all}${precise ? " s" : ""}`);
    this.speed.value = String(state.speed);
    const play = this.toggles.get("playing")!;
    play.dataset.playing = String(state.playing);
    play.setAttribute("aria-label", state.playing ? "Pause" : "Play");
    for (const what of ["loop", "follow", "skeleton", "contacts", "trail", "recording", "dark"] as const) {
      this.toggles.get(what)!.setAttribute("aria-pressed", String(state[what]));
    }
    this.toggles.get("loop")!.hidden = state.live;
  }

  /** Ticks where prompts begin. */
  mark(prompts: readonly Prompt[], fps: number, duration: number): void {
    const inside = prompts.filter((prompt) => prompt.firstFrame > 0 && prompt.firstFrame / fps < duration);
    for (const mark of this.marks) mark.remove();
    this.marks = inside.map(({ text, firstFrame }) => {
      const mark = element("button", { type: "button", class: "mv-mark", title: text, "aria-label": `Go to: ${text}` });
      const place = firstFrame / fps / duration;
      // The slider's thumb keeps its whole width inside the track.
      mark.style.left = `calc(7.5px + ${place} * (100% - 15px))`;
      mark.addEventListener("click", () => this.asked.seek(firstFrame / fps));
      return mark;
    });
    this.scrub.append(...this.marks);
  }
}
