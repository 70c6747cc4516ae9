/** Panels that a button opens: one at a time, closed by Escape, a press outside, or the button again. */
import { byId } from "./dom";

export class Popover {
  private static open: Popover | null = null;
  readonly panel: HTMLElement;
  private readonly button: HTMLElement;

  constructor(
    button: string,
    panel: string,
    private readonly fill: () => void,
  ) {
    this.button = byId(button);
    this.panel = byId(panel);
    this.button.addEventListener("click", () => (Popover.open === this ? this.close() : this.show()));
  }

  show(): void {
    if ((this.button as HTMLButtonElement).disabled) return;
    Popover.open?.close();
    Popover.open = this;
    this.fill();
    this.panel.hidden = false;
    this.button.setAttribute("aria-expanded", "true");
    this.panel.querySelector<HTMLElement>("button:not([disabled]), select")?.focus();
  }

  close(focus = true): void {
    if (Popover.open !== this) return;
    Popover.open = null;
    this.panel.hidden = true;
    this.button.setAttribute("aria-expanded", "false");
    if (focus) this.button.focus();
  }

  /** Close whatever is open; false where nothing was. */
  static dismiss(): boolean {
    if (!Popover.open) return false;
    Popover.open.close();
    return true;
  }

  /** Watch for presses outside and for the focus leaving. */
  static watch(): void {
    const outside = (target: EventTarget | null): boolean => {
      const one = Popover.open;
      return !!one && target instanceof Node && !one.panel.contains(target) && !one.button.contains(target);
    };
    document.addEventListener("pointerdown", (event) => {
      if (outside(event.target)) Popover.open!.close(false);
    });
    document.addEventListener("focusin", (event) => {
      if (outside(event.target)) Popover.open!.close(false);
    });
  }
}
