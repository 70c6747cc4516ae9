/** Keys of the player: what each of them does. */

import { SPEEDS } from "./controls";
import type { Player } from "./player";
import type { View } from "./view";

/** Hear keys of a target until the signal says that it is enough. */
export function hearKeys(target: EventTarget, player: Player, view: View, signal: AbortSignal): void {
  const heard = (event: Event) => answer(event as KeyboardEvent, player, view);
  target.addEventListener("keydown", heard, { signal });
}

function answer(event: KeyboardEvent, player: Player, view: View): void {
  const target = event.target as HTMLElement;
  const typing = target.closest("input:not([type=range]), textarea, select, [contenteditable]");
  if (typing || event.ctrlKey || event.metaKey || event.altKey) return;
  // A focused button answers space and enter itself.
  if (target.closest("button") && (event.key === " " || event.key === "Enter")) return;
  const act = action(event, player, view);
  if (!act) return;
  event.preventDefault();
  act();
}

function action(event: KeyboardEvent, player: Player, view: View): (() => void) | null {
  const step = event.shiftKey ? player.fps : 1;
  const still = (frame: number) => () => {
    player.pause();
    player.seek(frame);
  };
  const speed = (by: number) => () => {
    const at = SPEEDS.findIndex((value) => value >= player.speed);
    player.speed = SPEEDS[Math.min(Math.max((at < 0 ? SPEEDS.length - 1 : at) + by, 0), SPEEDS.length - 1)];
  };
  switch (event.key) {
    case " ": case "k": return () => player.toggle("playing"); // prettier-ignore
    case "ArrowLeft": return still(Math.ceil(player.frame - 1e-6) - step); // prettier-ignore
    case "ArrowRight": return still(Math.floor(player.frame + 1e-6) + step); // prettier-ignore
    case "ArrowUp": return speed(1); // prettier-ignore
    case "ArrowDown": return speed(-1); // prettier-ignore
    case "Home": return () => player.seek(0); // prettier-ignore
    case "End": return still(player.duration * player.fps); // prettier-ignore
    case "l": return () => player.toggle("loop"); // prettier-ignore
    case "f": return () => player.toggle("follow"); // prettier-ignore
    case "s": return () => player.toggle("skeleton"); // prettier-ignore
    case "c": return () => player.toggle("contacts"); // prettier-ignore
    case "t": return () => player.toggle("trail"); // prettier-ignore
    case "d": return () => player.toggle("dark"); // prettier-ignore
    case "v": return () => player.toggle("recording"); // prettier-ignore
    case "F": return () => player.toggle("full"); // prettier-ignore
    case "r": return () => player.resetView(); // prettier-ignore
    case "a": return () => view.turn(-0.15, 0); // prettier-ignore
    case "e": return () => view.turn(0.15, 0); // prettier-ignore
    case "+": return () => view.zoomBy(0.87); // prettier-ignore
    case "-": return () => view.zoomBy(1.15); // prettier-ignore
    default: return null; // prettier-ignore
  }
}
