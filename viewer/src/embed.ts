/** How pages show motions: what they get as `MovesetPlayer`. */

import { Player, type PlayerOptions, type Prompt } from "./player/player";
import { Skeleton, type SkeletonData } from "./skeleton";
import { Take } from "./take";

export { Player, Skeleton, Take };

/** One motion: packets as base64, in one text or in several that follow one another. */
export interface TakeData {
  title: string;
  prompts?: Prompt[];
  data: string | string[];
}

/** Takes to be seen side by side. */
export interface SceneData {
  skeleton: SkeletonData;
  takes: TakeData[];
}

declare global {
  interface Window {
    /** For tests, to read only. */
    __moveset?: { player: Player };
  }
}

/** Show takes in an element. */
export function mount(container: HTMLElement, scene: SceneData, options: PlayerOptions = {}): Player {
  const player = new Player(container, options);
  show(player, scene);
  window.__moveset = { player };
  return player;
}

/** Show other takes. */
export function show(player: Player, scene: SceneData): void {
  const skeleton = new Skeleton(scene.skeleton);
  player.setTakes(scene.takes.map(({ title, prompts, data }) => ({ title, prompts, take: Take.from(skeleton, data) })));
}
