/** The takes of this visit, newest first: choosing one brings it back to the stage. */
import { byId, clock, make } from "./dom";
import { Popover } from "./popover";
import type { Shown } from "./shown";
import type { Entry } from "./timeline";

/** Streams can be long: so many takes are remembered and no more. */
const MOST = 12;

export interface Kept {
  shown: Shown;
  /** The prompts that made a clip; empty for a stream. */
  entries: Entry[];
}

export class Recent {
  /** How many there were, forgotten ones included. */
  added = 0;
  private kept: Kept[] = [];
  private readonly popover: Popover;

  constructor(private readonly choose: (kept: Kept) => void) {
    this.popover = new Popover("open-recent", "recent", () => this.fill());
  }

  add(kept: Kept): void {
    this.added++;
    this.kept = [kept, ...this.kept].slice(0, MOST);
    if (!this.popover.panel.hidden) this.fill();
  }

  private fill(): void {
    byId("shelf-empty").hidden = this.kept.length > 0;
    const rows = this.kept.map((kept) => {
      const { takes, title, kind } = kept.shown;
      const many = takes.length > 1 ? `${takes.length} takes · ` : "";
      const facts = `${kind === "live" ? "Live · " : ""}${many}${clock(takes[0].take.seconds)} · seed ${takes[0].seed}`;
      const button = make("button", { type: "button", class: "kept" }, make("strong", {}, title), make("span", {}, facts));
      button.addEventListener("click", () => {
        this.popover.close();
        this.choose(kept);
      });
      return make("li", {}, button);
    });
    byId("shelf").replaceChildren(...rows);
  }
}
