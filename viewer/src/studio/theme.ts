/** Light or dark: what the system says, until somebody chooses otherwise; the choice is remembered by the browser. */
import { forget, recall, remember } from "./memory";

const KEY = "moveset-theme";
export type Theme = "light" | "dark";

const system = matchMedia("(prefers-color-scheme: dark)");

function chosen(): Theme | null {
  const stored = recall(KEY);
  return stored === "light" || stored === "dark" ? stored : null;
}

/** The theme in force. */
export function theme(): Theme {
  return chosen() ?? (system.matches ? "dark" : "light");
}

/** Call `follow` with the theme now and whenever it changes; returns the switch. */
export function themes(follow: (theme: Theme) => void): () => void {
  const apply = (): void => {
    const own = chosen();
    if (own) document.documentElement.dataset.theme = own;
    else delete document.documentElement.dataset.theme;
    follow(theme());
  };
  system.addEventListener("change", apply);
  apply();
  return () => {
    const wanted: Theme = theme() === "dark" ? "light" : "dark";
    // Back to what the system says is no choice at all: it follows the system again.
    if (wanted === (system.matches ? "dark" : "light")) forget(KEY);
    else remember(KEY, wanted);
    apply();
  };
}
