/** What a page may tell the player. */

import type { Take } from "../take";
import type { Prompt } from "./controls";
import type { ThemeName } from "./theme";

export interface PlayerTake {
  take: Take;
  title: string;
  /** What was said, and from which frame on; in order. May grow while the player shows it. */
  prompts?: Prompt[];
}

export interface PlayerOptions {
  theme?: ThemeName | "auto";
  /** By default where the reader's system asks for no less motion. */
  autoplay?: boolean;
  /** Where keys are heard: the player itself (default), or the whole page. */
  keys?: "player" | "page";
  /** Name of recorded videos. */
  filename?: string;
}

export interface SetTakesOptions {
  /** The first take is still growing: play waits at its end instead of stopping. */
  live?: boolean;
}
