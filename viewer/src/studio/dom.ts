/** The few DOM helpers that the page needs. Text always arrives as text nodes: nothing here parses HTML. */

/** The element with this id; a missing one is a fault of index.html and must be heard of. */
export function byId<T extends HTMLElement = HTMLElement>(id: string): T {
  const element = document.getElementById(id);
  if (!element) throw new Error(`index.html has no #${id}`);
  return element as T;
}

type Attributes = Record<string, string | number | boolean>;

/** A new element: attributes by name (false leaves one out), children as elements or text. */
export function make<K extends keyof HTMLElementTagNameMap>(
  tag: K,
  attributes: Attributes = {},
  ...children: (Node | string)[]
): HTMLElementTagNameMap[K] {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value !== false) element.setAttribute(name, value === true ? "" : String(value));
  }
  element.append(...children);
  return element;
}

const SVG = "http://www.w3.org/2000/svg";

/** One of the icons drawn in index.html. */
export function icon(name: string): SVGSVGElement {
  const svg = document.createElementNS(SVG, "svg");
  svg.setAttribute("class", "icon");
  svg.setAttribute("aria-hidden", "true");
  const use = document.createElementNS(SVG, "use");
  use.setAttribute("href", `#i-${name}`);
  svg.append(use);
  return svg;
}

/** Change the icon and the words of a button made of an icon and a span. */
export function relabel(button: HTMLElement, name: string, words: string): void {
  button.querySelector("use")!.setAttribute("href", `#i-${name}`);
  button.querySelector("span")!.textContent = words;
}

/** Tell screen readers, without stealing the focus. */
export function announce(words: string): void {
  byId("status").textContent = words;
}

/**
 * A row of exclusive choices as a radio group with one tab stop: arrows, Home and End move and choose.
 * Returns a function that chooses from outside, without calling `chosen`.
 */
export function segments<T>(
  group: HTMLElement,
  choices: { value: T; label: string; title?: string }[],
  value: T,
  chosen: (value: T) => void,
): (value: T) => void {
  const buttons = choices.map((choice) =>
    make("button", { type: "button", role: "radio", title: choice.title ?? false, value: choice.label }, choice.label),
  );
  const show = (wanted: T): void => {
    choices.forEach((choice, k) => {
      const on = choice.value === wanted;
      buttons[k].setAttribute("aria-checked", String(on));
      buttons[k].tabIndex = on ? 0 : -1;
    });
    if (!choices.some((choice) => choice.value === wanted) && buttons[0]) buttons[0].tabIndex = 0;
  };
  buttons.forEach((button, k) =>
    button.addEventListener("click", () => {
      show(choices[k].value);
      chosen(choices[k].value);
    }),
  );
  roving(group, () => buttons);
  group.replaceChildren(...buttons);
  show(value);
  return show;
}

/** Arrow keys, Home and End among the buttons of a group, pressing the one that they reach. */
export function roving(group: HTMLElement, buttons: () => HTMLElement[]): void {
  // Assigned, not added: a group may be filled anew.
  group.onkeydown = (event) => {
    const all = buttons();
    const at = all.indexOf(document.activeElement as HTMLElement);
    const step = { ArrowRight: 1, ArrowDown: 1, ArrowLeft: -1, ArrowUp: -1 }[event.key];
    const to = event.key === "Home" ? 0 : event.key === "End" ? all.length - 1 : step ? at + step : -1;
    if (at < 0 || to < 0 || to >= all.length) return;
    event.preventDefault();
    all[to].focus();
    all[to].click();
  };
}

/** A time as people read it on a transport: 7.4 s, 1:07.4. */
export function clock(seconds: number): string {
  const tenths = Math.round(Math.max(0, seconds) * 10);
  if (tenths < 600) return `${(tenths / 10).toFixed(1)} s`;
  const rest = tenths % 600;
  return `${Math.floor(tenths / 600)}:${rest < 100 ? "0" : ""}${(rest / 10).toFixed(1)}`;
}

/** Offer a blob as a download, as a link to it that is pressed. */
export function save(blob: Blob, name: string): void {
  const url = URL.createObjectURL(blob);
  const link = make("a", { href: url, download: name });
  document.body.append(link);
  link.click();
  link.remove();
  // The browser has taken its reference by the next task; a minute is generous for slow disks.
  setTimeout(() => URL.revokeObjectURL(url), 60_000);
}
