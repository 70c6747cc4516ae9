/** Clip mode: from the prompt box and the timeline to finished takes side by side. */
import { type Generated, generate, type ModelInfo } from "./api";
import { byId, clock, segments } from "./dom";
import { back, fault, made, notice, phase } from "./page";
import { fromAnswer, type Shown } from "./shown";
import { type Entry, MOST_ENTRIES, Timeline } from "./timeline";
import { toast } from "./toasts";

const MOST_TAKES = 4;
/** Quick key presses on an edge of the timeline are one change: milliseconds. */
const SETTLE_MS = 350;

export interface ClipEvents {
  /** Something new is to be shown; `entries` made it. */
  made(shown: Shown, entries: Entry[]): void;
}

export class Clip {
  readonly timeline: Timeline;
  readonly prompt = byId<HTMLTextAreaElement>("prompt");
  private readonly seconds = byId<HTMLInputElement>("seconds");
  private readonly seed = byId<HTMLInputElement>("seed");
  private model: ModelInfo | null = null;
  private steps = 1;
  private num = 1;
  private lastSeed: number | null = null;
  private working: AbortController | null = null;
  private settling = 0;

  constructor(private readonly events: ClipEvents) {
    this.timeline = new Timeline(byId("timeline"), {
      selected: () => this.showEntry(),
      changed: () => {
        this.showEntry();
        this.settle();
      },
      counted: () => this.showCount(),
      alone: () => this.prompt.focus(),
    });
    segments(byId("takes"), numbers(1, MOST_TAKES), 1, (num) => {
      this.num = num;
      this.settle();
    });
    this.seconds.addEventListener("change", () => {
      const wanted = this.seconds.valueAsNumber;
      this.timeline.current.seconds = Number.isFinite(wanted) ? wanted : null;
      this.timeline.draw();
      this.settle();
    });
    byId("pin-seed").addEventListener("click", () => this.pin());
    this.seed.addEventListener("input", () => this.showPin());
    byId("add-prompt").addEventListener("click", () => this.add());
    byId("again").addEventListener("click", () => this.again());
  }

  /** Use this model: its steps and its limits. */
  use(model: ModelInfo): void {
    this.model = model;
    this.steps = model.default_steps;
    const [shortest, longest] = [model.min_seconds ?? 0.5, model.max_seconds ?? 60];
    this.timeline.limit(shortest, longest);
    this.seconds.min = String(shortest);
    this.seconds.max = String(longest);
    segments(byId("steps"), model.steps.map(stepChoice), this.steps, (steps) => {
      this.steps = steps;
      this.settle();
    });
  }

  /** The text in the prompt box belongs to the current entry. */
  typed(): void {
    this.timeline.current.text = this.prompt.value;
    if (this.timeline.entries.length > 1) this.timeline.draw();
  }

  /** One more prompt after the current one. */
  add(): void {
    this.typed();
    if (!this.timeline.current.text.trim()) this.prompt.focus();
    else if (!this.timeline.add()) toast(`A timeline holds ${MOST_ENTRIES} prompts; remove one to add another.`);
    else this.prompt.focus();
  }

  /** A suggestion: say it now. */
  say(text: string): void {
    this.prompt.value = text;
    this.typed();
    void this.submit();
  }

  /** The same prompts with another seed. */
  again(): void {
    if (byId<HTMLButtonElement>("again").disabled) return;
    this.seed.value = "";
    this.showPin();
    void this.submit();
  }

  /** Back to what was made earlier, from this seed. */
  restore(entries: Entry[], seed = this.lastSeed): void {
    clearTimeout(this.settling);
    this.lastSeed = seed;
    this.showPin();
    this.timeline.load(entries.map((entry) => ({ ...entry })));
    this.showEntry();
  }

  /** Whatever is being made is no longer wanted. */
  leave(): void {
    clearTimeout(this.settling);
    this.working?.abort();
  }

  /** Make takes of what is written; `seed` overrides the seed field. */
  async submit(seed: number | null = null): Promise<void> {
    clearTimeout(this.settling);
    this.typed();
    const entries = this.timeline.entries;
    const silent = entries.findIndex((entry) => !entry.text.trim());
    if (silent >= 0) {
      if (silent !== this.timeline.selected) this.timeline.select(silent);
      this.prompt.focus();
      return notice(entries.length > 1 ? ["This prompt of the timeline is still empty."] : []);
    }
    this.working?.abort();
    const working = (this.working = new AbortController());
    // The timeline may be written on while the server works; what is made is what was asked for.
    const asked = entries.map((entry) => ({ entry, as: { ...entry } }));
    phase("busy");
    try {
      const begun = performance.now();
      const answer = await generate(
        {
          prompts: asked.map(({ as: { text, seconds } }) => ({ text: text.trim(), seconds })),
          model: this.model?.name ?? null,
          steps: this.steps,
          seed: seed ?? (this.seed.value === "" ? null : this.seed.valueAsNumber),
          num: this.num,
        },
        working.signal,
      );
      back();
      this.take(answer, asked, performance.now() - begun);
    } catch (thrown) {
      if (working.signal.aborted) return;
      fault(thrown, () => void this.submit(seed));
    } finally {
      if (this.working === working) {
        this.working = null;
        phase("idle");
      }
    }
  }

  private take(answer: Generated, asked: { entry: Entry; as: Entry }[], waited: number): void {
    const first = answer.takes[0];
    asked.forEach(({ entry, as }, k) => {
      const end = first.prompts[k + 1]?.first_frame ?? first.frames;
      entry.made = as.made = (end - (first.prompts[k]?.first_frame ?? 0)) / first.fps;
    });
    phase("shown");
    this.lastSeed = answer.seed;
    this.timeline.draw();
    this.showPin();
    byId<HTMLButtonElement>("again").disabled = false;
    notice(answer.warnings);
    const inside = Object.values(answer.timings_ms).reduce((sum, part) => sum + part, 0);
    const many = answer.takes.length > 1 ? `${answer.takes.length} takes of ` : "";
    const time = Math.round(inside || waited);
    made(`${many}${clock(first.seconds)} · ${answer.steps} ${answer.steps > 1 ? "steps" : "step"} · seed ${answer.seed} · made in ${time} ms`);
    this.events.made(fromAnswer(answer), asked.map(({ as }) => as));
  }

  /** After a change of length, steps or number: the same seed again, once the hand rests. */
  private settle(): void {
    clearTimeout(this.settling);
    if (this.lastSeed === null || !this.timeline.entries.every((entry) => entry.text.trim())) return;
    this.settling = window.setTimeout(() => void this.submit(this.lastSeed), SETTLE_MS);
  }

  private pin(): void {
    this.seed.value = this.seed.value === "" && this.lastSeed !== null ? String(this.lastSeed) : "";
    this.showPin();
  }

  private showPin(): void {
    const pinned = this.seed.value !== "";
    byId("pin-seed").setAttribute("aria-pressed", String(pinned));
    byId("pin-seed").title = pinned ? "A new seed each time" : "Keep the seed of the take shown";
    this.seed.placeholder = this.lastSeed === null ? "any" : String(this.lastSeed);
  }

  private showEntry(): void {
    const entry = this.timeline.current;
    this.prompt.value = entry.text;
    this.prompt.dispatchEvent(new Event("input"));
    this.seconds.value = entry.seconds === null ? "" : String(entry.seconds);
    this.seconds.placeholder = entry.made === null ? "auto" : entry.made.toFixed(1);
  }

  private showCount(): void {
    const several = this.timeline.entries.length > 1;
    document.body.classList.toggle("has-timeline", several);
    this.prompt.placeholder = several ? "And then?" : "A person waves with both hands";
    byId<HTMLButtonElement>("add-prompt").disabled = this.timeline.entries.length >= MOST_ENTRIES;
    this.showEntry();
  }
}

/** Fill the row of suggestions; each press calls `say`. */
export function suggest(known: string[], say: (text: string) => void): void {
  const chips = known.map((text) => {
    const chip = document.createElement("button");
    chip.type = "button";
    chip.className = "chip";
    chip.textContent = text;
    chip.addEventListener("click", () => say(text));
    return chip;
  });
  byId("chips").replaceChildren(...chips);
}

export function stepChoice(steps: number): { value: number; label: string; title: string } {
  return { value: steps, label: String(steps), title: `${steps} network ${steps > 1 ? "evaluations" : "evaluation"}` };
}

function numbers(from: number, to: number): { value: number; label: string }[] {
  return Array.from({ length: to - from + 1 }, (_, k) => ({ value: from + k, label: String(from + k) }));
}
