/** Keys for everything, and the panel that lists them. Single keys can be switched off there. */
import { byId, make } from "./dom";
import { forget, recall, remember } from "./memory";
import { Popover } from "./popover";

const KEY = "moveset-single-keys";

export interface Shortcut {
  /** As in KeyboardEvent.key. */
  key: string;
  /** As people read it. */
  keys: string;
  does: string;
  run(): void;
}

/** Keys that belong to the prompt box, for the list. */
const WRITING = [
  { keys: "Enter", does: "Move, or steer the stream" },
  { keys: "Ctrl Enter", does: "One more prompt on the timeline" },
  { keys: "Shift Enter", does: "New line" },
];

/** Keys that the player answers, for the list; the rest of them stands on its buttons. */
const PLAYING = [
  { keys: "Space", does: "Play or pause" },
  { keys: "← →", does: "One frame back or on" },
  { keys: "F S C T", does: "Follow, skeleton, contacts, trail" },
  { keys: "+ − R", does: "Nearer, farther, as at first" },
];

/** Listen to single keys wherever nobody is writing or choosing; `player` has those that are not in the list. */
export function shortcuts(list: Shortcut[], player: (event: KeyboardEvent) => boolean): void {
  const help = byId<HTMLDialogElement>("help");
  const single = byId<HTMLInputElement>("single-keys");
  single.checked = recall(KEY) !== "off";
  single.addEventListener("change", () => {
    if (single.checked) forget(KEY);
    else remember(KEY, "off");
  });
  const rows = [...WRITING, ...list, ...PLAYING].map(({ keys, does }) =>
    make("div", {}, make("dt", {}, ...keys.split(" ").map((one) => make("kbd", {}, one))), make("dd", {}, does)),
  );
  byId("keys").replaceChildren(...rows);
  byId("open-help").addEventListener("click", () => help.showModal());
  byId("close-help").addEventListener("click", () => help.close());
  help.addEventListener("click", ({ target, clientX, clientY }) => {
    // Its own rim is the same element as what is behind it.
    const { left, right, top, bottom } = help.getBoundingClientRect();
    const beside = clientX < left || clientX > right || clientY < top || clientY > bottom;
    if (target === help && beside) help.close();
  });
  document.addEventListener("keydown", (event) => {
    if (event.key === "Escape" && Popover.dismiss()) return event.preventDefault();
    if (event.defaultPrevented || event.ctrlKey || event.metaKey || event.altKey || help.open) return;
    if (!single.checked || writes(event.target)) return;
    // Space presses the button that has the focus, and is only ours elsewhere.
    if (event.key === " " && within(event.target, "button, a, [role]")) return;
    const wanted = list.find((shortcut) => shortcut.key === event.key);
    if (wanted) wanted.run();
    // What was pressed in the player and comes here is none of its keys.
    else if (within(event.target, ".moveset-player") || !player(event)) return;
    event.preventDefault();
  });
}

function writes(target: EventTarget | null): boolean {
  return within(target, "input:not([type=checkbox], [type=range]), textarea, select, [contenteditable]");
}

function within(target: EventTarget | null, selector: string): boolean {
  return target instanceof Element && target.closest(selector) !== null;
}
