/** What both modes say to the page around them: gentle notes, faults, and that the server is gone. */
import { ServerError, Unreachable } from "./api";
import { announce, byId } from "./dom";
import { toast } from "./toasts";

/** A gentle note above the prompt box, such as that a sentence is far from what the model knows. */
export function notice(lines: string[]): void {
  const box = byId("notice");
  box.textContent = lines.join(" ");
  box.hidden = lines.length === 0;
}

/** What was made, in a line above the prompt box; screen readers hear it as well. */
export function made(words: string): void {
  byId("made").textContent = words;
  if (words) announce(words);
}

let filled = false;

/** Something is being made, or came onto the stage, or neither: then the page is as it was before. */
export function phase(now: "busy" | "shown" | "idle"): void {
  filled ||= now === "shown";
  document.body.dataset.phase = now === "busy" ? "busy" : filled ? "shown" : "empty";
}

let retry: (() => void) | null = null;

/** The server is gone: say so until `again` succeeds or somebody calls `back`. */
export function gone(words: string, again: () => void): void {
  byId("gone-text").textContent = words;
  byId("gone").hidden = false;
  document.body.dataset.connection = "lost";
  retry = again;
}

/** The server answers again. */
export function back(): void {
  byId("gone").hidden = true;
  document.body.dataset.connection = "open";
  retry = null;
}

/** The button of the message that `gone` shows. */
export function watchReconnect(): void {
  byId("reconnect").addEventListener("click", () => retry?.());
}

/** Tell of a fault: the server's own sentence, or that it is gone, with a way to try again. */
export function fault(thrown: unknown, again: () => void): void {
  if (thrown instanceof Unreachable) return gone(thrown.message, again);
  toast((thrown as Error).message, "fault");
  // A fault of the page itself must be seen where developers look; refusals of the server are no such fault.
  if (!(thrown instanceof ServerError)) console.error(thrown);
}
