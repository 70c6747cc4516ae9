/** The motion player: takes on a stage, a clock, a camera and a bar of controls. */

import { Cast } from "./cast";
import { Controls, type Prompt, type Toggle } from "./controls";
import { adopt, element } from "./dom";
import type { Overlays } from "./figure";
import { fit, lookAt } from "./gaze";
import { hearKeys } from "./keys";
import { Meter } from "./meter";
import type { PlayerOptions, PlayerTake, SetTakesOptions } from "./options";
import { canRecord, download, Recording } from "./recording";
import { Sharpness } from "./sharpness";
import { Stage } from "./stage";
import { PLAYER_CSS } from "./styles";
import { systemTheme, type ThemeName } from "./theme";
import { type CameraMode, View } from "./view";

export type { CameraMode, Overlays, PlayerOptions, PlayerTake, Prompt, SetTakesOptions, ThemeName };

export class Player {
  readonly root: HTMLElement;
  readonly canvas = element("canvas", { role: "img" });
  loop = true;
  /** Called whenever another moment is shown: frame of the first take, which may lie between two. */
  onframe: ((frame: number) => void) | null = null;
  /** Called when playing, speed, overlays, camera or theme changed. */
  onstate: (() => void) | null = null;
  private readonly stage: Stage;
  private readonly sharpness: Sharpness;
  private readonly view: View;
  private readonly controls: Controls;
  private readonly labels = element("div", { class: "mv-labels", "aria-hidden": "true" });
  private readonly caption = element("div", { class: "mv-caption", "aria-live": "polite" });
  private readonly watcher: ResizeObserver;
  private readonly stop = new AbortController();
  private readonly forgetTheme: (() => void) | null;
  private readonly filename: string;
  private cast = new Cast([], false);
  private time = 0;
  private known = { frames: -1, prompts: -1, duration: -1 };
  private isPlaying = false;
  private isLive = false;
  private rate = 1;
  private mode: CameraMode = "follow";
  private shown: Overlays = { skeleton: false, contacts: false, trail: false };
  private colours: ThemeName = "light";
  private dirty = true;
  private ask = 0;
  private last = 0;
  private recording: Recording | null = null;
  private covered: { above: number; below: number } | null = null;
  private readonly meter = new Meter();

  constructor(container: HTMLElement, options: PlayerOptions = {}) {
    adopt(PLAYER_CSS);
    this.root = element("div", { class: "moveset-player", tabindex: "0", role: "region", "aria-label": "Motion player" });
    this.filename = options.filename ?? "motion";
    this.isPlaying = options.autoplay ?? !matchMedia("(prefers-reduced-motion: reduce)").matches;
    this.root.append(this.canvas, this.labels);
    container.append(this.root);
    try {
      this.stage = new Stage(this.canvas);
    } catch (error) {
      this.root.append(element("div", { class: "mv-fault" }, "This browser cannot show 3D pictures (no WebGL 2)."));
      throw error;
    }
    this.root.toggleAttribute("data-software", this.software);
    this.sharpness = new Sharpness(this.software ? 1 : Infinity);
    this.view = new View(this.stage.camera, this.canvas, () => this.touch());
    const asked = {
      toggle: (what: Toggle) => this.toggle(what),
      seek: (seconds: number) => this.seek(seconds * this.fps),
      speed: (value: number) => (this.speed = value),
    };
    this.controls = new Controls(asked);
    this.root.append(this.caption, this.controls.root);
    this.watcher = new ResizeObserver(() => this.resize());
    this.watcher.observe(this.root);
    hearKeys(options.keys === "page" ? document : this.root, this, this.view, this.stop.signal);
    document.addEventListener("visibilitychange", () => this.returned(), { signal: this.stop.signal });
    this.canvas.addEventListener("webglcontextrestored", () => this.touch(), { signal: this.stop.signal });
    const theme = options.theme ?? "auto";
    this.forgetTheme = theme === "auto" ? systemTheme((name) => (this.theme = name)) : null;
    if (theme !== "auto") this.theme = theme;
    this.resize();
  }

  /** Whether a processor draws in a graphics card's place. */
  get software(): boolean {
    return this.stage.software;
  }

  /** Show takes, side by side where there are several, from their beginning. */
  setTakes(entries: PlayerTake[], options: SetTakesOptions = {}): void {
    for (const { group } of this.cast.figures) this.stage.scene.remove(group);
    this.cast.dispose();
    this.isLive = options.live ?? false;
    this.cast = new Cast([...entries], this.software);
    this.cast.paint(this.stage.setTheme(this.colours));
    this.cast.show(this.shown);
    for (const { group } of this.cast.figures) this.stage.scene.add(group);
    this.labels.replaceChildren(...this.cast.tags);
    const { described } = this.cast;
    this.canvas.setAttribute("aria-label", described ? `A moving figure: ${described}` : "A moving figure");
    this.time = 0;
    this.view.shift.set(0, 0, 0);
    this.aim(true);
    this.known = { frames: -1, prompts: -1, duration: -1 };
    this.resize();
  }

  /** Look again, since a take that is shown or its prompts grew. */
  grown(): void {
    this.touch();
  }

  /** While true, play waits at the end for more. */
  get live(): boolean {
    return this.isLive;
  }

  set live(value: boolean) {
    this.isLive = value;
    this.touch(true);
  }

  get playing(): boolean {
    return this.isPlaying;
  }

  play(): void {
    if (!this.isLive && this.time >= this.duration) this.time = 0;
    this.isPlaying = true;
    this.last = 0;
    this.touch(true);
  }

  pause(): void {
    this.isPlaying = false;
    this.touch(true);
  }

  /** Go to a frame of the first take, which may lie between two. */
  seek(frame: number): void {
    this.time = Math.min(Math.max(frame / this.fps, 0), this.duration);
    this.touch();
  }

  /** Frame of the first take that is shown; it may lie between two. */
  get frame(): number {
    return this.time * this.fps;
  }

  get fps(): number {
    return this.cast.fps;
  }

  /** Seconds of the longest take. */
  get duration(): number {
    return this.cast.duration;
  }

  get speed(): number {
    return this.rate;
  }

  set speed(value: number) {
    this.rate = Math.min(Math.max(value, 0.05), 8);
    this.touch(true);
  }

  get camera(): CameraMode {
    return this.mode;
  }

  set camera(mode: CameraMode) {
    this.mode = mode;
    this.fit();
    this.touch(true);
  }

  get overlays(): Overlays {
    return { ...this.shown };
  }

  set overlays(overlays: Partial<Overlays>) {
    this.shown = { ...this.shown, ...overlays };
    this.cast.show(this.shown);
    this.touch(true);
  }

  get theme(): ThemeName {
    return this.colours;
  }

  set theme(name: ThemeName) {
    this.colours = name;
    this.root.dataset.theme = name;
    this.cast.paint(this.stage.setTheme(name));
    this.touch(true);
  }

  /** Pixels of the picture that a page covers above and below; by default what the player's own caption and bar do. */
  set inset(covered: { above: number; below: number } | null) {
    this.covered = covered;
    this.resize();
  }

  /** (J, 3) world positions of the joints as drawn at a frame, in the take's own place. */
  jointPositions(frame: number, takeIndex = 0): Float32Array {
    return this.cast.entries[takeIndex].take.positions(frame);
  }

  /** The last pictures' distances in time and the time spent on each by this page, milliseconds. */
  frameTimes(): { interval: number[]; work: number[] } {
    return this.meter.times();
  }

  /** A WebM video of the takes from beginning to end, or until the bar's button ends it, at the speed shown. */
  async recordVideo(): Promise<Blob> {
    if (this.recording) return this.recording.done;
    this.recording = new Recording(this.canvas);
    const before = { time: this.time, playing: this.isPlaying };
    if (!this.isLive) this.time = 0;
    this.isPlaying = true;
    this.touch(true);
    try {
      return await this.recording.done;
    } finally {
      this.recording = null;
      if (!this.isLive) [this.time, this.isPlaying] = [before.time, before.playing];
      this.touch(true);
    }
  }

  /** The view as it was at first. */
  resetView(): void {
    this.view.reset();
    this.aim(true);
  }

  dispose(): void {
    cancelAnimationFrame(this.ask);
    this.stop.abort();
    this.watcher.disconnect();
    this.forgetTheme?.();
    this.recording?.stop();
    this.view.dispose();
    this.cast.dispose();
    this.stage.dispose();
    this.root.remove();
  }

  /** Something changed: draw again, and tell. */
  private touch(told = false): void {
    this.dirty = true;
    if (told) this.onstate?.();
    if (!this.ask) this.ask = requestAnimationFrame((now) => this.tick(now));
  }

  private tick(now: number): void {
    const since = this.last ? now - this.last : 0;
    this.last = now;
    this.ask = 0;
    if (this.isPlaying && !document.hidden && since > 0) this.advance(Math.min(since, 250) / 1000);
    const grew = this.notice();
    const turning = this.aim(false, since / 1000);
    this.spare(since);
    if (this.dirty || grew || turning || this.isPlaying) {
      const begun = performance.now();
      this.dirty = false;
      this.draw();
      this.meter.drawn(performance.now() - begun, since);
    }
    if (this.isPlaying || turning || this.dirty) this.ask ||= requestAnimationFrame((next) => this.tick(next));
    else this.last = 0;
  }

  /** Where drawing cannot keep up, fewer pixels while the picture moves, and all of them when it stands. */
  private spare(since: number): void {
    const { stage, sharpness } = this;
    const moving = this.isPlaying && !this.recording;
    if (!moving) sharpness.forget();
    else if (since > 0) sharpness.moved(since, stage.full);
    const ratio = moving ? sharpness.ratio(stage.full) : this.recording ? stage.screen : stage.full;
    if (ratio === stage.ratio) return;
    stage.ratio = ratio;
    this.dirty = true;
  }

  /** Seen again, or not seen any more: the time between says nothing about drawing. */
  private returned(): void {
    this.last = 0;
    this.sharpness.forget();
    this.touch();
  }

  private advance(seconds: number): void {
    const { duration } = this;
    this.time += seconds * this.rate;
    if (this.time < duration) return;
    if (this.recording && !this.isLive) {
      this.recording.stop();
      this.time = duration;
    } else if (this.loop && !this.isLive && duration > 0) {
      this.time %= duration;
    } else {
      this.time = duration;
      if (!this.isLive) this.pause();
    }
  }

  /** Whether takes or prompts grew; marks and caption follow. */
  private notice(): boolean {
    const { frames } = this.cast;
    const prompts = this.cast.entries[0]?.prompts ?? [];
    const { duration } = this;
    const { known } = this;
    if (known.frames === frames && known.prompts === prompts.length && known.duration === duration) return false;
    this.known = { frames, prompts: prompts.length, duration };
    this.controls.mark(prompts, this.fps, duration);
    this.fit();
    return true;
  }

  private draw(): void {
    this.cast.update(this.time);
    const { target } = this.view;
    this.stage.follow(target.x, target.z, this.cast.spread / 2 + (this.mode === "orbit" ? 2 : 0));
    this.view.apply();
    this.stage.render();
    this.cast.placeTags(this.stage.camera, this.root.clientWidth, this.root.clientHeight);
    this.say();
    this.onframe?.(this.frame);
    this.controls.update({
      playing: this.isPlaying,
      live: this.isLive,
      seconds: this.time,
      duration: this.duration,
      speed: this.rate,
      loop: this.loop,
      follow: this.mode === "follow",
      ...this.shown,
      recording: this.recording !== null,
      dark: this.colours === "dark",
    });
  }

  private say(): void {
    const said = this.cast.entries[0]?.prompts?.findLast(({ firstFrame }) => firstFrame <= this.frame + 1e-6);
    const text = said?.text ?? "";
    if (this.caption.textContent !== text) this.caption.textContent = text;
  }

  /** Camera towards what it looks at; whether it is still on its way. */
  private aim(atOnce: boolean, seconds = 0): boolean {
    const wanted = lookAt(this.cast, this.mode, this.isLive, this.time) ?? this.view.target;
    if (!this.view.aim(wanted, atOnce, seconds)) return false;
    this.dirty = true;
    return true;
  }

  private fit(): void {
    fit(this.view, this.cast, this.mode, this.isLive);
    this.dirty = true;
  }

  private resize(): void {
    const { clientWidth: width, clientHeight: height } = this.root;
    if (width === 0 || height === 0) return;
    this.stage.resize(width, height);
    // The picture's middle is that of what caption and bar leave free.
    const below = this.covered?.below ?? this.controls.root.offsetHeight + 14;
    const above = this.covered?.above ?? 46 + (this.cast.tags.length > 0 ? 26 : 0);
    const free = Math.max(0.4, 1 - (below + above) / height);
    const { camera } = this.stage;
    camera.setViewOffset(width, height, 0, (below - above) / 2, width, height);
    this.view.free = free;
    this.fit();
    this.touch();
  }

  /** What the bar's buttons do; by default play or pause. */
  toggle(what: Toggle = "playing"): void {
    if (what === "playing") this.isPlaying ? this.pause() : this.play();
    else if (what === "loop") this.loop = !this.loop;
    else if (what === "follow") this.camera = this.mode === "follow" ? "orbit" : "follow";
    else if (what === "recording") this.toggleRecording();
    else if (what === "dark") this.theme = this.colours === "dark" ? "light" : "dark";
    else if (what === "full") void (document.fullscreenElement ? document.exitFullscreen() : this.root.requestFullscreen());
    else this.overlays = { [what]: !this.shown[what] };
    this.touch(true);
  }

  /** Whoever began a recording saves it; ending it is all that anybody else does. */
  private toggleRecording(): void {
    if (this.recording) this.recording.stop();
    else if (canRecord()) void this.recordVideo().then((video) => download(video, `${this.filename}.webm`));
  }
}
