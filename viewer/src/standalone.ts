/** Entry of the player build: the global `MovesetPlayer`, and the page of a file that carries its own motions. */

import { mountPage, type PageData } from "./page";

export * from "./embed";
export { mountPage };

/** The data stand behind this script, so that a page may be read while it is still being written. */
function start(): void {
  const carried = document.getElementById("moveset-page");
  if (carried) mountPage(document.body, JSON.parse(carried.textContent) as PageData);
}

if (document.readyState === "loading") document.addEventListener("DOMContentLoaded", start);
else start();
