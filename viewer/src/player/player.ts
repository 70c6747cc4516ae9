/** The motion player: takes on a stage, a clock, a camera and a bar of controls. */

import * as THREE from "three";
import type { Take } from "../take";
import type { Packet } from "../wire";
import { Controls, type Prompt, SPEEDS, type Toggle } from "./controls";
import { adopt, element } from "./dom";
import { Figure, type Overlays } from "./figure";
import { download, Recording } from "./recording";
import { Sharpness } from "./sharpness";
import { Stage } from "./stage";
import { PLAYER_CSS } from "./styles";
import { systemTheme, type ThemeName } from "./theme";
import { type CameraMode, View } from "./view";

export type { CameraMode, Overlays, Prompt, ThemeName };

export interface PlayerTake {
  take: Take;
  title: string;
  /** What was said, and from which frame on; in order. May grow while the player shows it. */
  prompts?: Prompt[];
}

export interface PlayerOptions {
  theme?: ThemeName | "auto";
  autoplay?: boolean;
  loop?: boolean;
  camera?: CameraMode;
  overlays?: Partial<Overlays>;
  /** The bar under the picture (default), and the prompt of the moment above it (default). */
  controls?: boolean;
  caption?: boolean;
  /** Where keys are heard: the player itself (default), or the whole page. */
  keys?: "player" | "page";
  /** Name of recorded videos. */
  filename?: string;
}

export interface SetTakesOptions {
  /** The first take is still growing: play waits at its end instead of stopping. */
  live?: boolean;
  /** Leave camera and clock as they are. */
  keep?: boolean;
}

/** Height of what is looked at, and half of what must be seen above and below it. */
const EYE = 0.96;
const HALF_HEIGHT = 1.08;
/** How many frame times are remembered. */
const MEASURED = 240;

export class Player {
  readonly root: HTMLElement;
  readonly canvas = element("canvas", { role: "img" });
  loop: boolean;
  /** Called whenever another moment is shown: frame of the first take, which may lie between two. */
  onframe: ((frame: number) => void) | null = null;
  /** Called when playing, speed, overlays, camera or theme changed. */
  onstate: (() => void) | null = null;
  private readonly stage: Stage;
  private readonly sharpness: Sharpness;
  private readonly view: View;
  private readonly controls: Controls | null;
  private readonly labels = element("div", { class: "mv-labels", "aria-hidden": "true" });
  private readonly caption = element("div", { class: "mv-caption", "aria-live": "polite" });
  private readonly watcher: ResizeObserver;
  private readonly stop = new AbortController();
  private readonly forgetTheme: (() => void) | null;
  private readonly filename: string;
  private figures: Figure[] = [];
  private tags: HTMLElement[] = [];
  private entries: PlayerTake[] = [];
  private time = 0;
  private known = { frames: -1, prompts: -1, duration: -1 };
  private isPlaying = false;
  private isLive = false;
  private rate = 1;
  private mode: CameraMode;
  private shown: Overlays;
  private colours: ThemeName = "light";
  private spread = 0;
  private dirty = true;
  private ask = 0;
  private last = 0;
  private recording: Recording | null = null;
  private covered: { above: number; below: number } | null = null;
  private readonly intervals: number[] = [];
  private readonly work: number[] = [];

  constructor(container: HTMLElement, options: PlayerOptions = {}) {
    adopt(PLAYER_CSS);
    this.root = element("div", { class: "moveset-player", tabindex: "0", role: "region", "aria-label": "Motion player" });
    this.loop = options.loop ?? true;
    this.mode = options.camera ?? "follow";
    this.shown = { skeleton: false, contacts: false, trail: false, ...options.overlays };
    this.filename = options.filename ?? "motion";
    this.isPlaying = options.autoplay ?? true;
    this.root.append(this.canvas, this.labels);
    container.append(this.root);
    try {
      this.stage = new Stage(this.canvas);
    } catch (error) {
      this.root.append(element("div", { class: "mv-fault" }, "This browser cannot show 3D pictures (no WebGL 2)."));
      throw error;
    }
    this.sharpness = new Sharpness(this.stage.software ? 1 : Infinity);
    this.view = new View(this.stage.camera, this.canvas, () => this.touch());
    if (options.caption ?? true) this.root.append(this.caption);
    const asked = {
      toggle: (what: Toggle) => this.toggle(what),
      seek: (seconds: number) => this.seek(seconds * this.fps),
      speed: (value: number) => (this.speed = value),
    };
    this.controls = (options.controls ?? true) ? new Controls(asked) : null;
    if (this.controls) this.root.append(this.controls.root);
    this.watcher = new ResizeObserver(() => this.resize());
    this.watcher.observe(this.root);
    const keys: EventTarget = options.keys === "page" ? document : this.root;
    keys.addEventListener("keydown", (event) => this.key(event as KeyboardEvent), { signal: this.stop.signal });
    document.addEventListener("visibilitychange", () => this.returned(), { signal: this.stop.signal });
    const theme = options.theme ?? "auto";
    this.forgetTheme = theme === "auto" ? systemTheme((name) => (this.theme = name)) : null;
    if (theme !== "auto") this.theme = theme;
    this.resize();
  }

  /** Show takes, side by side where there are several, from their beginning. */
  setTakes(entries: PlayerTake[], options: SetTakesOptions = {}): void {
    for (const figure of this.figures) {
      this.stage.scene.remove(figure.group);
      figure.dispose();
    }
    this.entries = [...entries];
    this.isLive = options.live ?? false;
    this.figures = entries.map(({ take }) => new Figure(take, this.stage.software));
    this.arrange();
    const theme = this.stage.setTheme(this.colours);
    for (const figure of this.figures) {
      figure.paint(theme);
      figure.show(this.shown);
      this.stage.scene.add(figure.group);
    }
    this.tags = entries.length > 1 ? entries.map(({ title }) => element("div", { class: "mv-label" }, title)) : [];
    this.labels.replaceChildren(...this.tags);
    const described = entries.map(({ title }) => title).filter(Boolean).join("; ");
    this.canvas.setAttribute("aria-label", described ? `A moving figure: ${described}` : "A moving figure");
    if (options.keep) this.time = Math.min(this.time, this.duration);
    else {
      this.time = 0;
      this.view.shift.set(0, 0, 0);
      this.aim(true);
    }
    this.known = { frames: -1, prompts: -1, duration: -1 };
    this.resize();
  }

  /** Add a packet to a take that is shown; without one: look again, since a take or its prompts grew. */
  append(packet?: Packet, takeIndex = 0): void {
    if (packet) this.entries[takeIndex].take.append(packet);
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
    return this.entries[0]?.take.fps ?? 20;
  }

  /** Seconds of the longest take. */
  get duration(): number {
    return Math.max(0, ...this.entries.map(({ take }) => take.seconds));
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
    for (const figure of this.figures) figure.show(this.shown);
    this.touch(true);
  }

  get theme(): ThemeName {
    return this.colours;
  }

  set theme(name: ThemeName) {
    this.colours = name;
    this.root.dataset.theme = name;
    const theme = this.stage.setTheme(name);
    for (const figure of this.figures) figure.paint(theme);
    this.touch(true);
  }

  /** Pixels of the picture that a page covers above and below; by default what the player's own caption and bar do. */
  set inset(covered: { above: number; below: number } | null) {
    this.covered = covered;
    this.resize();
  }

  /** (J, 3) world positions of the joints as drawn at a frame, in the take's own place. */
  jointPositions(frame: number, takeIndex = 0): Float32Array {
    return this.entries[takeIndex].take.positions(frame);
  }

  /** The last pictures' distances in time and the time spent on each by this page, milliseconds. */
  frameTimes(): { interval: number[]; work: number[] } {
    return { interval: [...this.intervals], work: [...this.work] };
  }

  /** A WebM video of the takes from beginning to end at the speed they are shown; stops early when asked again. */
  async recordVideo(): Promise<Blob> {
    if (this.recording) {
      this.recording.stop();
      return this.recording.done;
    }
    const before = { time: this.time, playing: this.isPlaying };
    if (!this.isLive) this.time = 0;
    this.isPlaying = true;
    this.recording = new Recording(this.canvas);
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
    for (const figure of this.figures) figure.dispose();
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
      remember(this.work, performance.now() - begun);
      if (since > 0) remember(this.intervals, since);
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
    const frames = this.entries.reduce((sum, { take }) => sum + take.frames, 0);
    const prompts = this.entries[0]?.prompts ?? [];
    const { duration } = this;
    const { known } = this;
    if (known.frames === frames && known.prompts === prompts.length && known.duration === duration) return false;
    this.known = { frames, prompts: prompts.length, duration };
    this.controls?.mark(prompts, this.fps, duration);
    this.fit();
    return true;
  }

  private draw(): void {
    for (const figure of this.figures) {
      if (figure.take.frames > 0) figure.update(this.time * figure.take.fps);
    }
    const { target } = this.view;
    this.stage.follow(target.x, target.z, this.spread / 2 + (this.mode === "orbit" ? 2 : 0));
    this.view.apply();
    this.stage.render();
    this.placeLabels();
    this.say();
    this.onframe?.(this.frame);
    this.controls?.update({
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
    const said = this.entries[0]?.prompts?.findLast(({ firstFrame }) => firstFrame <= this.frame + 1e-6);
    const text = said?.text ?? "";
    if (this.caption.textContent !== text) this.caption.textContent = text;
  }

  private placeLabels(): void {
    const { clientWidth: width, clientHeight: height } = this.root;
    this.tags.forEach((tag, k) => {
      const { group, pose } = this.figures[k];
      const head = Math.max(...pose.positions.filter((_, at) => at % 3 === 1)) + 0.3;
      spot.set(pose.positions[0] + group.position.x, head, pose.positions[2] + group.position.z);
      spot.project(this.stage.camera);
      const [x, y] = [(0.5 + 0.5 * spot.x) * width, (0.5 - 0.5 * spot.y) * height];
      tag.hidden = spot.z > 1;
      tag.style.transform = `translate(${x.toFixed(1)}px, ${Math.max(y, 4).toFixed(1)}px) translate(-50%, -100%)`;
    });
  }

  /** Side by side, as far apart as the takes move sideways, within reason. */
  private arrange(): void {
    const count = this.figures.length;
    const reach = Math.max(0, ...this.entries.map(({ take }) => sideways(take)));
    const gap = Math.min(Math.max(1.25, 0.9 + reach), 2.4);
    // On screen the first take is on the left; the camera stands on the side that faces see.
    this.figures.forEach((figure, k) => {
      const along = (k - (count - 1) / 2) * gap;
      figure.group.position.set(along * SIDE[0], 0, along * SIDE[1]);
    });
    this.spread = (count - 1) * gap;
  }

  /** Camera towards what it looks at; whether it is still on its way. */
  private aim(atOnce: boolean, seconds = 0): boolean {
    const wanted = this.lookAt();
    const { target } = this.view;
    const away = target.distanceTo(wanted);
    if (atOnce || away > 2.5) target.copy(wanted);
    else if (away > 1e-3) target.lerp(wanted, 1 - Math.exp(-7 * Math.min(seconds, 0.25)));
    else return false;
    this.dirty = true;
    return true;
  }

  private lookAt(): THREE.Vector3 {
    const takes = this.entries.map(({ take }) => take).filter((take) => take.frames > 0);
    if (takes.length === 0) return new THREE.Vector3(0, EYE, 0);
    if (this.mode === "orbit" && !this.isLive) {
      const { low, high } = this.extent();
      return new THREE.Vector3((low[0] + high[0]) / 2, EYE, (low[1] + high[1]) / 2);
    }
    if (this.mode === "orbit") return this.view.target.clone();
    const mean = new THREE.Vector3();
    for (const take of takes) mean.add(spot.fromArray(take.root(this.time * take.fps)));
    mean.divideScalar(takes.length);
    return mean.setY(EYE + 0.6 * Math.max(0, mean.y - 1.15));
  }

  /** Where the roots of all takes go: least and greatest x and z. */
  private extent(): { low: [number, number]; high: [number, number] } {
    const [low, high]: [[number, number], [number, number]] = [[Infinity, Infinity], [-Infinity, -Infinity]]; // prettier-ignore
    for (const { take } of this.entries) {
      for (let frame = 0; frame < take.frames; frame += Math.max(1, Math.floor(take.frames / 200))) {
        const [x, , z] = take.root(frame);
        [low[0], low[1]] = [Math.min(low[0], x), Math.min(low[1], z)];
        [high[0], high[1]] = [Math.max(high[0], x), Math.max(high[1], z)];
      }
    }
    return { low, high };
  }

  private fit(): void {
    let half = this.spread / 2;
    if (this.mode === "orbit" && !this.isLive && this.entries.some(({ take }) => take.frames > 0)) {
      const { low, high } = this.extent();
      half += Math.hypot(high[0] - low[0], high[1] - low[1]) / 2;
    }
    this.view.fitBox(half + 0.62, HALF_HEIGHT + 0.12 * half);
    this.dirty = true;
  }

  private resize(): void {
    const { clientWidth: width, clientHeight: height } = this.root;
    if (width === 0 || height === 0) return;
    this.stage.resize(width, height);
    // The picture's middle is that of what caption and bar leave free.
    const below = this.covered?.below ?? (this.controls ? this.controls.root.offsetHeight + 14 : 0);
    const above = this.covered?.above ?? ((this.caption.isConnected ? 46 : 0) + (this.tags.length > 0 ? 26 : 0));
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
    else if (what === "recording") void this.recordVideo().then((video) => this.recording || download(video, `${this.filename}.webm`));
    else if (what === "dark") this.theme = this.colours === "dark" ? "light" : "dark";
    else if (what === "full") void (document.fullscreenElement ? document.exitFullscreen() : this.root.requestFullscreen());
    else this.overlays = { [what]: !this.shown[what] };
    this.touch(true);
  }

  private key(event: KeyboardEvent): void {
    const target = event.target as HTMLElement;
    const typing = target.closest("input:not([type=range]), textarea, select, [contenteditable]");
    if (typing || event.ctrlKey || event.metaKey || event.altKey) return;
    // A focused button answers space and enter itself.
    if (target.closest("button") && (event.key === " " || event.key === "Enter")) return;
    const act = this.act(event);
    if (!act) return;
    event.preventDefault();
    act();
  }

  private act(event: KeyboardEvent): (() => void) | null {
    const step = event.shiftKey ? this.fps : 1;
    const still = (frame: number) => () => {
      this.pause();
      this.seek(frame);
    };
    const speed = (by: number) => () => {
      const at = SPEEDS.findIndex((value) => value >= this.rate);
      this.speed = SPEEDS[Math.min(Math.max((at < 0 ? SPEEDS.length - 1 : at) + by, 0), SPEEDS.length - 1)];
    };
    switch (event.key) {
      case " ": case "k": return () => this.toggle("playing"); // prettier-ignore
      case "ArrowLeft": return still(Math.ceil(this.frame - 1e-6) - step); // prettier-ignore
      case "ArrowRight": return still(Math.floor(this.frame + 1e-6) + step); // prettier-ignore
      case "ArrowUp": return speed(1); // prettier-ignore
      case "ArrowDown": return speed(-1); // prettier-ignore
      case "Home": return () => this.seek(0); // prettier-ignore
      case "End": return still(this.duration * this.fps); // prettier-ignore
      case "l": return () => this.toggle("loop"); // prettier-ignore
      case "f": return () => this.toggle("follow"); // prettier-ignore
      case "s": return () => this.toggle("skeleton"); // prettier-ignore
      case "c": return () => this.toggle("contacts"); // prettier-ignore
      case "t": return () => this.toggle("trail"); // prettier-ignore
      case "d": return () => this.toggle("dark"); // prettier-ignore
      case "v": return () => this.toggle("recording"); // prettier-ignore
      case "F": return () => this.toggle("full"); // prettier-ignore
      case "r": return () => this.resetView(); // prettier-ignore
      case "a": return () => this.view.turn(-0.15, 0); // prettier-ignore
      case "e": return () => this.view.turn(0.15, 0); // prettier-ignore
      case "+": return () => this.view.zoomBy(0.87); // prettier-ignore
      case "-": return () => this.view.zoomBy(1.15); // prettier-ignore
      default: return null; // prettier-ignore
    }
  }
}

/** Direction in which takes stand beside one another: to the right of a camera in its first place. */
const SIDE = [Math.cos(0.62), -Math.sin(0.62)] as const;
const spot = new THREE.Vector3();

/** How far a take's root moves in the direction of its neighbours. */
function sideways(take: Take): number {
  let [low, high] = [0, 0];
  for (let frame = 0; frame < take.frames; frame += 4) {
    const [x, , z] = take.root(frame);
    const along = x * SIDE[0] + z * SIDE[1];
    [low, high] = [Math.min(low, along), Math.max(high, along)];
  }
  return high - low;
}

function remember(values: number[], value: number): void {
  values.push(value);
  if (values.length > MEASURED) values.shift();
}
