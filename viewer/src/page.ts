/** A whole page of motions: a list of scenes beside the player. What `moveset generate … -o wave.html` writes. */

import { mount, type SceneData, show } from "./embed";
import { adopt, element } from "./player/dom";
import type { Player } from "./player/player";

/** A scene in the list. */
export interface ListedScene extends SceneData {
  title: string;
  /** A second line: seed, seconds, … */
  note?: string;
}

export interface PageData {
  title: string;
  scenes: ListedScene[];
}

const CSS = `
html, body { margin: 0; height: 100%; }
body { background: #e6eaf0; font: 14px/1.45 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
.mv-page { --ink: #1d2430; --soft: #5b6678; --side: #f4f6f9; --edge: rgba(30,40,60,.12); --on: rgba(106,92,194,.13); --accent: #6a5cc2;
  display: grid; height: 100vh; height: 100dvh; color: var(--ink); background: var(--side); }
.mv-page[data-theme=dark] { --ink: #e9edf4; --soft: #9aa7bb; --side: #191d25; --edge: rgba(200,215,240,.12); --on: rgba(167,155,245,.18); --accent: #a79bf5; }
.mv-page[data-list] { grid-template-columns: 268px minmax(0, 1fr); }
.mv-side { display: flex; flex-direction: column; min-height: 0; border-right: 1px solid var(--edge); }
.mv-side h1 { margin: 0; padding: 20px 20px 12px; font-size: 16px; font-weight: 650; letter-spacing: -.01em; overflow-wrap: anywhere; }
.mv-list { flex: 1; margin: 0; padding: 0 10px 16px; overflow-y: auto; list-style: none; }
.mv-list button { display: block; width: 100%; padding: 9px 12px; border: 0; border-radius: 10px; background: none; color: inherit; font: inherit; font-weight: 500;
  text-align: left; cursor: pointer; overflow-wrap: anywhere; }
.mv-list button:hover { background: var(--edge); }
.mv-list button:focus-visible { outline: 2px solid var(--accent); outline-offset: -2px; }
.mv-list button[aria-current=true] { background: var(--on); color: var(--accent); }
.mv-list small { display: block; color: var(--soft); font-size: 12px; font-weight: 400; }
@media (max-width: 700px) {
  .mv-page[data-list] { grid-template-columns: none; grid-template-rows: auto minmax(0, 1fr); }
  .mv-side { border: 0; border-bottom: 1px solid var(--edge); min-width: 0; }
  .mv-side h1 { padding: 10px 14px 4px; font-size: 14px; }
  .mv-list { display: flex; gap: 4px; padding: 0 8px 8px; overflow: auto hidden; }
  .mv-list li { flex: none; }
  .mv-list button { max-width: 72vw; padding: 6px 12px; overflow: hidden; text-overflow: ellipsis; white-space: nowrap; }
  .mv-list small { display: none; }
}
`;

/** Build the page in an element; the address's #2 opens the second scene. */
export function mountPage(container: HTMLElement, page: PageData): Player {
  adopt(CSS);
  const stage = element("main");
  const root = element("div", { class: "mv-page" }, stage);
  container.append(root);
  const listed = page.scenes.length > 1;
  const linked = Number(location.hash.slice(1)) - 1;
  let current = listed && page.scenes[linked] ? linked : 0;
  const player = mount(stage, page.scenes[current], { keys: "page" });
  const follow = () => (root.dataset.theme = player.theme);
  player.onstate = follow;
  follow();
  if (!listed) return player;

  const buttons = page.scenes.map(({ title, note }, k) => {
    const button = element("button", { type: "button" }, title, ...(note ? [element("small", {}, note)] : []));
    button.addEventListener("click", () => choose(k));
    return button;
  });
  const mark = () => buttons.forEach((button, k) => button.setAttribute("aria-current", String(k === current)));
  const choose = (k: number) => {
    current = k;
    show(player, page.scenes[k]);
    player.play();
    mark();
    buttons[k].scrollIntoView({ block: "nearest", inline: "nearest" });
  };
  const list = element("ul", { class: "mv-list" }, ...buttons.map((button) => element("li", {}, button)));
  root.dataset.list = "";
  root.prepend(element("nav", { class: "mv-side", "aria-label": "Motions" }, element("h1", {}, page.title), list));
  addEventListener("keydown", (event) => {
    const by = event.key === "n" ? 1 : event.key === "p" ? -1 : 0;
    if (by && !event.ctrlKey && !event.metaKey && !event.altKey) choose((current + by + buttons.length) % buttons.length);
  });
  mark();
  return player;
}
