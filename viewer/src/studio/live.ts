/** Live mode: a stream that plays while it is made, and that every new sentence steers. */
import { Skeleton } from "../skeleton";
import { Take } from "../take";
import { parsePackets } from "../wire";
import type { ModelInfo } from "./api";
import { stepChoice } from "./clip";
import { announce, byId, clock, relabel, segments } from "./dom";
import { LiveStrip } from "./live_strip";
import { back, gone, made, notice, phase } from "./page";
import type { Mark, Shown } from "./shown";
import { type ServerMessage, type Stage, type Started, Stream } from "./stream";
import { toast } from "./toasts";

export type LiveState = "idle" | "connecting" | "running" | "paused" | "stopping" | "lost";

/** How often playing is acknowledged: milliseconds. */
const ACKNOWLEDGE_MS = 150;

export interface LiveEvents {
  /** Frames have come and are to be shown while more arrive. */
  begun(shown: Shown): void;
  /** Frames were added to what is shown. */
  grown(): void;
  /** The stream is over, or a copy of it was asked for: keep it. */
  kept(shown: Shown): void;
  /** Whether motion is to be played or to stand still. */
  playing(on: boolean): void;
  ended(): void;
}

export class Live {
  state: LiveState = "idle";
  shown: Shown | null = null;
  started: Started | null = null;
  private stream: Stream | null = null;
  private take: Take | null = null;
  private marks: Mark[] = [];
  private prompt = "";
  private acknowledged = -1;
  private acknowledgedAt = 0;
  private expected: Mark | null = null;
  private model: ModelInfo | null = null;
  private steps = 1;
  private readonly strip: LiveStrip;

  constructor(private readonly events: LiveEvents) {
    this.strip = new LiveStrip(byId("live-strip"), () => this.take?.fps ?? 20);
    byId("live-pause").addEventListener("click", () => this.pause());
    byId("live-stop").addEventListener("click", () => this.stop());
    byId("live-keep").addEventListener("click", () => this.keep());
    byId("buffer").addEventListener("change", () => this.stream?.send({ type: "set", buffer: this.buffer }));
  }

  use(model: ModelInfo): void {
    this.model = model;
    this.steps = model.default_steps;
    segments(byId("live-steps"), model.steps.map(stepChoice), this.steps, (steps) => {
      this.steps = steps;
      this.stream?.send({ type: "set", steps });
    });
  }

  get open(): boolean {
    return this.state === "connecting" || this.state === "running" || this.state === "paused";
  }

  /** A new sentence: begins a stream, or steers the one that runs. */
  say(text: string): void {
    if (!text.trim()) return;
    if (this.state === "running" || this.state === "paused") {
      this.prompt = text;
      this.stream!.send({ type: "prompt", text: text.trim() });
      if (this.state === "paused") this.pause();
      return;
    }
    this.start(text.trim());
  }

  private get buffer(): number {
    return Number(byId<HTMLSelectElement>("buffer").value);
  }

  /** Frames ahead of the one played that a new prompt may not change any more; null keeps all that was sent. */
  private get commit(): number | null {
    const seconds = byId<HTMLSelectElement>("commit").value;
    return seconds === "" ? null : Math.round(Number(seconds) * (this.model?.fps ?? 20));
  }

  private start(text: string): void {
    this.leave();
    this.prompt = text;
    made("");
    notice([]);
    this.enter("connecting");
    phase("busy");
    const seed = byId<HTMLInputElement>("live-seed");
    const options = {
      prompt: text,
      model: this.model?.name ?? null,
      seed: seed.value === "" ? null : seed.valueAsNumber,
      steps: this.steps,
      buffer: this.buffer,
      commit: this.commit,
    };
    this.stream = new Stream(options, {
      message: (message) => this.hear(message),
      packet: (bytes) => this.receive(bytes),
      closed: (ended) => this.closed(ended),
    });
  }

  private hear(message: ServerMessage): void {
    switch (message.type) {
      case "started":
        back();
        this.started = message;
        this.take = new Take(new Skeleton(message.skeleton));
        this.take.fps = message.fps;
        this.mark({ text: this.prompt, firstFrame: 0 });
        byId<HTMLInputElement>("live-seed").placeholder = String(message.seed);
        // It may have been stopped meanwhile.
        if (this.state === "connecting") this.enter("running");
        break;
      case "prompt":
        this.steer(message.stages);
        notice(message.warnings);
        break;
      case "segment":
        byId("figure-latency").textContent = `${Math.round(message.latency_ms)} ms`;
        break;
      case "stopped":
        if (message.reason !== "refused" && this.state !== "stopping") toast(`The stream ended: ${message.reason}.`);
        break;
      case "error":
        toast(message.message, "fault");
        // Of a stream that has not begun there is nothing more to come; another one goes on.
        if (!this.started) this.leave();
        break;
    }
  }

  /** A new sentence in its stages ("walks, then waves" has two), each with the frame from which it counts. */
  private steer(stages: Stage[]): void {
    // What was made ahead for the sentence before is void from there: a busy server must not let it be played as the new.
    this.take?.truncate(stages[0].takes_effect_at);
    const marks = stages.map((stage) => ({ text: stage.text, firstFrame: stage.takes_effect_at }));
    marks.forEach((mark) => this.mark(mark));
    const next = marks.find((mark) => mark.firstFrame > 0);
    if (!next) return;
    this.expected = next;
    announce(`“${next.text}” takes effect at ${clock(next.firstFrame / (this.take?.fps ?? 20))}`);
  }

  /** What is said from a frame on; one that is not reached yet is replaced by a later one. */
  private mark(mark: Mark): void {
    while (this.marks.length && this.marks[this.marks.length - 1].firstFrame >= mark.firstFrame) this.marks.pop();
    this.marks.push(mark);
    this.strip.follow(this.marks);
    if (this.shown) this.events.grown();
  }

  private receive(bytes: ArrayBuffer): void {
    if (!this.take) return;
    for (const packet of parsePackets(bytes)) {
      // After a new prompt the server makes anew what was not committed: those frames replace the ones that were sent.
      this.take.truncate(packet.firstFrame);
      this.take.append(packet);
    }
    if (this.shown) return this.events.grown();
    const seed = this.started!.seed;
    this.shown = { kind: "live", title: this.prompt, takes: [{ take: this.take, title: "", seed, prompts: this.marks }] };
    phase("shown");
    this.events.begun(this.shown);
  }

  /** The player shows this frame: acknowledge it, move the strip, count down to the next prompt. */
  at(frame: number): void {
    if (!this.take || !this.shown) return;
    const { fps, frames } = this.take;
    const now = performance.now();
    const whole = Math.floor(frame);
    if (this.open && whole > this.acknowledged && now - this.acknowledgedAt > ACKNOWLEDGE_MS) {
      this.stream?.send({ type: "played", frame: whole });
      this.acknowledged = whole;
      this.acknowledgedAt = now;
    }
    this.strip.draw(frame, frames);
    byId("figure-time").textContent = clock(frame / fps);
    byId("figure-ahead").textContent = this.open ? clock((frames - 1 - frame) / fps) : "–";
    const wait = this.expected ? (this.expected.firstFrame - frame) / fps : 0;
    if (this.expected && wait <= 0) {
      announce(`Now: ${this.expected.text}`);
      this.expected = this.marks.find((mark) => mark.firstFrame > frame) ?? null;
    }
    const next = this.expected ? `${clock(this.expected.firstFrame / fps)}, in ${clock(wait)}` : "–";
    byId("figure-prompt").textContent = next;
  }

  /** Pause or go on, the motion and the making of it. */
  pause(): void {
    if (this.state === "running") this.events.playing(false);
    else if (this.state === "paused") this.events.playing(true);
  }

  /** The player plays or stands still, whoever asked it to: the server has nothing to make for a motion that stands. */
  follow(playing: boolean): void {
    if (this.state === "running" && this.shown && !playing) this.stream?.send({ type: "pause" });
    else if (this.state === "paused" && playing) this.stream?.send({ type: "resume" });
    else return;
    this.enter(playing ? "running" : "paused");
  }

  /** End the stream; what was made stays on the stage and among the recent takes. */
  stop(): void {
    if (!this.open) return;
    this.stream?.stop();
    this.enter("stopping");
  }

  /** Turn to something else: a stream ends at once, its take is kept, and nothing more is heard of it. */
  leave(): void {
    const rest = this.stream ? this.copy() : null;
    if (rest) this.events.kept(rest);
    if (this.stream) this.events.ended();
    this.stream?.abandon();
    this.stream = this.take = this.shown = this.started = this.expected = null;
    this.acknowledged = -1;
    this.marks = [];
    this.strip.follow(this.marks);
    if (this.state !== "idle") this.enter("idle");
    phase("idle");
  }

  /** A copy of everything so far, while the stream goes on. */
  keep(): void {
    const copy = this.copy();
    if (!copy) return;
    this.events.kept(copy);
    toast(`Kept ${clock(copy.takes[0].take.seconds)}. It is among the recent takes.`);
  }

  private copy(): Shown | null {
    if (!this.shown || !this.take) return null;
    const take = this.take.copy();
    const prompts = this.marks.filter((mark) => mark.firstFrame < take.frames);
    const title = prompts.map((mark) => mark.text).join(", then ");
    return { kind: "live", title, takes: [{ take, title: "", seed: this.started!.seed, prompts }] };
  }

  private closed(ended: boolean): void {
    const lost = !ended && this.state !== "stopping";
    const copy = this.copy();
    this.stream = null;
    this.enter(lost ? "lost" : "idle");
    phase("idle");
    if (copy) {
      this.events.kept(copy);
      made(`Stream of ${clock(copy.takes[0].take.seconds)} · seed ${copy.takes[0].seed}`);
    }
    this.events.ended();
    if (lost) gone("The connection to the server was lost.", () => this.start(this.prompt));
  }

  /** What the prompt box says while live mode has it. */
  label(): void {
    if (document.body.dataset.mode !== "live") return;
    byId("go-label").textContent = this.open ? "Steer" : "Start";
    byId<HTMLTextAreaElement>("prompt").placeholder = this.open ? "What next?" : "A person walks forward";
    byId("live-strip").hidden = !this.open && !this.shown;
  }

  private enter(state: LiveState): void {
    this.state = state;
    document.body.dataset.live = state;
    const button = (id: string): HTMLButtonElement => byId<HTMLButtonElement>(id);
    button("live-pause").disabled = state !== "running" && state !== "paused";
    button("live-stop").disabled = !this.open;
    button("live-keep").disabled = !this.open;
    byId<HTMLInputElement>("live-seed").disabled = this.open;
    byId<HTMLSelectElement>("live-model").disabled = byId<HTMLSelectElement>("commit").disabled = this.open;
    relabel(button("live-pause"), state === "paused" ? "play" : "pause", state === "paused" ? "Go on" : "Pause");
    this.label();
    const words = { idle: "Stream ended", connecting: "Starting", running: "Streaming", paused: "Paused", stopping: "Stopping", lost: "Connection lost" };
    announce(words[state]);
  }
}
