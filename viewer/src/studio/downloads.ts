/** Taking home what is on the stage: files made by the server from the shown bytes, and a video recorded here. */
import { canRecord } from "../player/recording";
import { type ExportLimits, exportFile, type Models } from "./api";
import { announce, byId, clock, icon, make, save } from "./dom";
import { back, fault } from "./page";
import { Popover } from "./popover";
import { firstThatFits, packets, type Shown, type ShownTake } from "./shown";
import { toast } from "./toasts";

const FORMATS = [
  { format: "bvh", name: "BVH", use: "Blender, MotionBuilder, Maya" },
  { format: "glb", name: "GLB", use: "Unity, Godot, three.js" },
  { format: "gltf", name: "glTF", use: "the same as text" },
  { format: "vrma", name: "VRMA", use: "VRM characters" },
  { format: "npz", name: "npz", use: "NumPy" },
  { format: "amass.npz", name: "AMASS", use: "SMPL-H tools, as npz" },
  { format: "html", name: "HTML", use: "a page that plays anywhere" },
  { format: "mp4", name: "MP4", use: "video, drawn by the server" },
  { format: "webm", name: "WebM", use: "video, recorded as you see it" },
];

/** The presets of moveset.motion.rigs, and what people call them. */
const SKELETONS = [
  { value: "", label: "moveset (hml22)" },
  { value: "smpl", label: "SMPL" },
  { value: "mixamo", label: "Mixamo" },
  { value: "vrm", label: "VRM" },
  { value: "ue5", label: "Unreal 5" },
];
const RATES = ["", "24", "30", "60"];
/** Characters of a title that the server takes; all prompts of a timeline or a stream together may be longer. */
const LONGEST_TITLE = 512;

export interface Source {
  shown(): Shown | null;
  /** Whether it still grows. */
  live(): boolean;
  record(): Promise<Blob>;
}

export class Downloads {
  private readonly popover: Popover;
  private readonly which = byId<HTMLSelectElement>("which");
  private readonly skeleton = byId<HTMLSelectElement>("skeleton");
  private readonly fps = byId<HTMLSelectElement>("fps");
  private limits: ExportLimits | null = null;

  constructor(private readonly source: Source) {
    this.popover = new Popover("open-downloads", "downloads", () => this.fill());
    this.skeleton.append(...SKELETONS.map(({ value, label }) => make("option", { value }, label)));
  }

  /** Offer what this server can write, and what the page records itself. */
  offer({ formats, limits }: Models): void {
    this.limits = limits;
    byId("formats").replaceChildren();
    for (const { format, name, use } of FORMATS) {
      if (format === "webm" ? !canRecord() : !formats.includes(format)) continue;
      const button = make(
        "button",
        { type: "button", class: "format", "data-format": format },
        make("strong", {}, name),
        make("span", {}, use),
        icon("download"),
      );
      button.addEventListener("click", () => void this.take(button, format));
      byId("formats").append(make("li", {}, button));
    }
  }

  /** Whether there is anything to take. */
  enable(on: boolean): void {
    byId<HTMLButtonElement>("open-downloads").disabled = !on;
  }

  show(): void {
    this.popover.show();
  }

  private fill(): void {
    const shown = this.source.shown();
    if (!shown) return;
    const rate = Math.round(shown.takes[0].take.fps);
    const chosen = this.fps.value;
    this.fps.replaceChildren(...RATES.map((value) => make("option", { value }, value || `${rate} (as made)`)));
    this.fps.value = chosen;
    byId("which-field").hidden = shown.takes.length < 2;
    this.which.replaceChildren(...shown.takes.map((take, k) => make("option", { value: k }, take.title || `Take ${k + 1}`)));
  }

  private chosen(shown: Shown): ShownTake {
    return shown.takes[Number(this.which.value) || 0] ?? shown.takes[0];
  }

  private async take(button: HTMLButtonElement, format: string): Promise<void> {
    const shown = this.source.shown();
    if (!shown || button.disabled) return;
    button.disabled = true;
    button.classList.add("busy");
    try {
      if (format === "webm") {
        const until = this.source.live() ? "until the stream or the bar's red button ends it" : "from beginning to end";
        toast(`Recording the stage ${until}…`);
        save(await this.source.record(), `${slug(shown.title)}.webm`);
      } else {
        const options = {
          skeleton: this.skeleton.value || null,
          fps: Number(this.fps.value) || null,
          in_place: byId<HTMLInputElement>("in-place").checked,
          loop: byId<HTMLInputElement>("loop").checked,
          title: shown.title.slice(0, LONGEST_TITLE),
        };
        const { take } = this.chosen(shown);
        const first = firstThatFits(take, format, options.fps ?? take.fps, this.limits!);
        const length = (take.frames - first) / take.fps;
        const { blob, name } = await exportFile(format, packets(take, first), options);
        back();
        save(blob, name);
        if (first > 0) toast(`Only the last ${clock(length)} fit into one ${format} file.`);
      }
      announce(`Saved as ${format}`);
    } catch (thrown) {
      fault(thrown, () => void this.take(button, format));
    } finally {
      button.disabled = false;
      button.classList.remove("busy");
    }
  }
}

/** A file name of the words of a title. */
function slug(title: string): string {
  const words = title.toLowerCase().match(/[a-z0-9]+/g) ?? ["moveset"];
  return words.join("-").slice(0, 60).replace(/-$/, "");
}
