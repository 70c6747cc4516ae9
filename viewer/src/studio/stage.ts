/** The player as the studio uses it: one thing shown at a time, everybody told of the frame. */
import { Player } from "../player/player";
import { byId } from "./dom";
import type { Shown } from "./shown";
import type { Theme } from "./theme";

/** Pixels between the player's bar and the prompt box, and for the line of words above the box. */
const GAP = 12;
const ABOVE_BOX = 42;

export class Stage {
  readonly player: Player;
  shown: Shown | null = null;
  /** Called when playing or pausing, or the player's own theme, may have changed. */
  onstate: (() => void) | null = null;
  private readonly listeners: ((frame: number) => void)[] = [];

  /** What lies over the picture: the figure stands between `above` and what `below` answers at the moment. */
  constructor(container: HTMLElement, theme: Theme, above: HTMLElement, below: () => HTMLElement) {
    this.player = new Player(container, { theme, autoplay: false, filename: "moveset" });
    document.body.classList.toggle("software", this.player.software);
    this.player.onframe = (frame) => {
      for (const listener of this.listeners) listener(frame);
    };
    this.player.onstate = () => this.onstate?.();
    const bar = this.player.root.querySelector<HTMLElement>(".mv-bar")!;
    const cover = (): void => {
      const { bottom: ground, height } = container.getBoundingClientRect();
      document.documentElement.style.setProperty("--bar", `${ground - bar.getBoundingClientRect().top + GAP}px`);
      const [top, bottom] = [above.getBoundingClientRect().bottom, ground - below().getBoundingClientRect().top];
      // On a low window the figure may reach behind the prompt box rather than become tiny.
      this.player.inset = { above: top, below: Math.min(bottom + ABOVE_BOX, 0.62 * height) };
    };
    window.addEventListener("resize", cover);
    const watcher = new ResizeObserver(cover);
    for (const element of [container, bar, byId("dock"), byId("composer")]) watcher.observe(element);
  }

  onFrame(listener: (frame: number) => void): void {
    this.listeners.push(listener);
  }

  set theme(theme: Theme) {
    this.player.theme = theme;
  }

  /** Show finished takes from their beginning. */
  show(shown: Shown, play: boolean): void {
    this.shown = shown;
    this.player.setTakes(shown.takes);
    if (play) this.player.play();
    else this.player.pause();
  }

  /** Show a take that grows while it plays. */
  follow(shown: Shown): void {
    this.shown = shown;
    this.player.setTakes(shown.takes, { live: true });
    this.player.play();
    this.player.camera = "follow";
  }

  /** What is shown has more frames or prompts. */
  grown(): void {
    this.player.grown();
  }

  /** What was growing is complete: play it like any other. */
  settle(): void {
    this.player.live = false;
  }

  /** A key that the player knows, pressed elsewhere on the page; whether it did something. */
  key(event: KeyboardEvent): boolean {
    const { key, shiftKey } = event;
    return !this.player.root.dispatchEvent(new KeyboardEvent("keydown", { key, shiftKey, cancelable: true }));
  }
}
