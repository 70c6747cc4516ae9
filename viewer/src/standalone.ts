/** Entry of the player build: the global `MovesetPlayer`, and the page of a file that carries its own motions. */

import { mountPage, type PageData } from "./page";

export * from "./embed";
export { mountPage };

const carried = document.getElementById("moveset-page");
if (carried) mountPage(document.body, JSON.parse(carried.textContent) as PageData);
