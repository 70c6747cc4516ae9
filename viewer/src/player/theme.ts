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
  sun: number;
  hemisphere: number;
  key: number;
  rim: number;
  /** Lines on the ground, and how strongly they show. */
  line: number;
  lineOpacity: number;
  /** The ground where the figures stand. */
  pool: number;
  shadow: number;
  trail: number;
}

export const THEMES: Record<ThemeName, Theme> = {
  light: {
    background: 0xe6eaf0,
    shell: 0xefeae1,
    core: 0x566073,
    left: 0xee7c54,
    right: 0x3a86be,
    face: 0x20262f,
    sky: 0xf4f8ff,
    sun: 0xfff3e2,
    earth: 0xaab2bf,
    hemisphere: 1.9,
    key: 1.6,
    rim: 0.5,
    line: 0x55637a,
    lineOpacity: 0.34,
    pool: 0xf4f6f9,
    shadow: 0.26,
    trail: 0x786cc4,
  },
  dark: {
    background: 0x161a21,
    shell: 0xe9e5dd,
    core: 0x55617a,
    left: 0xf08a62,
    right: 0x4b9ad6,
    face: 0x0d1014,
    sky: 0xbfd0ee,
    sun: 0xffeeda,
    earth: 0x343b48,
    hemisphere: 1.25,
    key: 2.45,
    rim: 1.4,
    line: 0x8fa3c4,
    lineOpacity: 0.26,
    pool: 0x2a313d,
    shadow: 0.5,
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
