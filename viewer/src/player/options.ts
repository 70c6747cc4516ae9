/** What a page may tell the player. */

import type { Take } from "../take";
import type { Prompt } from "./controls";
import type { Overlays } from "./figure";
import type { ThemeName } from "./theme";
import type { CameraMode } from "./view";

export interface PlayerTake {
  take: Take;
  title: string;
  /** What was said, and from which frame on; in order. May grow while the player shows it. */
  prompts?: Prompt[];
}

export interface PlayerOptions {
  theme?: ThemeName | "auto";
  autoplay?: boolean;
  loop?: boolean;
  camera?: CameraMode;
  overlays?: Partial<Overlays>;
  /** The bar under the picture (default), and the prompt of the moment above it (default). */
  controls?: boolean;
  caption?: boolean;
  /** Where keys are heard: the player itself (default), or the whole page. */
  keys?: "player" | "page";
  /** Name of recorded videos. */
  filename?: string;
}

export interface SetTakesOptions {
  /** The first take is still growing: play waits at its end instead of stopping. */
  live?: boolean;
  /** Leave camera and clock as they are. */
  keep?: boolean;
}
