/** Colours of the two themes; left and right are those of moveset's pictures. */

export type ThemeName = "light" | "dark";

export interface Theme {
  background: number;
  shell: number;
  core: number;
  left: number;
  right: number;
  face: number;
  /** Light from above and back from the ground, from the front, and from behind. */
  sky: number;
  earth: number;
  hemisphere: number;
  key: number;
  rim: number;
  /** Lines on the ground, and how strongly they show. */
  line: number;
  lineOpacity: number;
  shadow: number;
  trail: number;
}

export const THEMES: Record<ThemeName, Theme> = {
  light: {
    background: 0xe6eaf0,
    shell: 0xf3efe8,
    core: 0x4c5566,
    left: 0xee7c54,
    right: 0x3a86be,
    face: 0x20262f,
    sky: 0xffffff,
    earth: 0xaab2bf,
    hemisphere: 1.55,
    key: 2.1,
    rim: 0.7,
    line: 0x55637a,
    lineOpacity: 0.34,
    shadow: 0.3,
    trail: 0x786cc4,
  },
  dark: {
    background: 0x12151b,
    shell: 0xdcd7ce,
    core: 0x3a4352,
    left: 0xf08a62,
    right: 0x4b9ad6,
    face: 0x0d1014,
    sky: 0xbfd0ee,
    earth: 0x20242c,
    hemisphere: 1.05,
    key: 2.3,
    rim: 1.5,
    line: 0x8fa3c4,
    lineOpacity: 0.26,
    shadow: 0.55,
    trail: 0x9a8df0,
  },
};

/** What the reader's system prefers, and a way to hear of changes; returns how to stop listening. */
export function systemTheme(changed: (theme: ThemeName) => void): () => void {
  const query = matchMedia("(prefers-color-scheme: dark)");
  const tell = () => changed(query.matches ? "dark" : "light");
  tell();
  query.addEventListener("change", tell);
  return () => query.removeEventListener("change", tell);
}
