/** Elements without innerHTML, so that a page may forbid inline styles and scripts, and no text can become markup. */

export function element<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  attributes: Record<string, string> = {},
  ...children: (Node | string)[]
): HTMLElementTagNameMap[K] {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  made.append(...children);
  return made;
}

const SVG = "http://www.w3.org/2000/svg";

/** An icon of 24 units from path data; "filled" ones have no outline. */
export function icon(name: keyof typeof PATHS): SVGSVGElement {
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("viewBox", "0 0 24 24");
  svg.setAttribute("aria-hidden", "true");
  const path = document.createElementNS(SVG, "path");
  path.setAttribute("d", PATHS[name]);
  if (FILLED.has(name)) svg.classList.add("mv-filled");
  svg.append(path);
  return svg;
}

const circle = (x: number, y: number, r: number) => `M${x - r} ${y}a${r} ${r} 0 1 0 ${2 * r} 0a${r} ${r} 0 1 0 ${-2 * r} 0`;

const PATHS = {
  play: "M8 4.8v14.4c0 .6.7 1 1.2.6l11-7.2a.7.7 0 0 0 0-1.2l-11-7.2c-.5-.4-1.2 0-1.2.6z",
  pause: "M7 5h3.6v14H7zM13.4 5H17v14h-3.6z",
  loop: "M17 2.5l3.5 3.5L17 9.5M3.5 11.5V9a3 3 0 0 1 3-3h14M7 21.5L3.5 18 7 14.5M20.5 12.5V15a3 3 0 0 1-3 3h-14",
  follow: `${circle(12, 12, 5)}M12 2v4.5M12 17.5V22M2 12h4.5M17.5 12H22`,
  skeleton: `${circle(12, 4.6, 2.3)}M12 7v7.5M12 9.2L6.5 12.5M12 9.2l5.5 3.3M12 14.5L8.5 21.5M12 14.5l3.5 7`,
  contacts: "M4 20.5h16M7.5 4v6.5c0 2.5-1.5 3-1.5 5.5h11.5c0-2.6-2-3.2-4.3-4.2-1-.4-1.7-1.2-1.7-2.3V4z",
  trail: `M6 19.5h8.5a3.75 3.75 0 0 0 0-7.5h-5a3.75 3.75 0 0 1 0-7.5H17M15 2.2l2.5 2.3L15 6.8${circle(4.6, 19.5, 1.4)}`,
  record: circle(12, 12, 6),
  full: "M4 9V4h5M20 9V4h-5M4 15v5h5M20 15v5h-5",
  theme: `${circle(12, 12, 8)}M12 4v16a8 8 0 0 0 0-16z`,
} as const;
const FILLED = new Set<string>(["play", "pause", "record"]);

const adopted = new Set<string>();

/** Add style rules to the page, once. Constructed sheets are no inline styles, which a page may forbid. */
export function adopt(css: string): void {
  if (adopted.has(css)) return;
  adopted.add(css);
  const sheet = new CSSStyleSheet();
  sheet.replaceSync(css);
  document.adoptedStyleSheets = [...document.adoptedStyleSheets, sheet];
}

/** Seconds as people read them: 4.2 s below a minute, else 1:05. */
export function clock(seconds: number, precise: boolean): string {
  if (precise) return seconds.toFixed(1);
  const whole = Math.floor(seconds);
  return `${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}`;
}
