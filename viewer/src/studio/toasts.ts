/** Short messages at the edge of the stage. Faults stay longer than news, and both can be sent away. */
import { byId, icon, make } from "./dom";

const STAY_MS = { news: 5000, fault: 12000 };
const MOST = 4;

/** Show a message; returns how to take it away before its time. */
export function toast(words: string, kind: "news" | "fault" = "news"): () => void {
  const region = byId("toasts");
  const close = make("button", { type: "button", class: "tool small" }, icon("close"), make("span", { class: "hidden" }, "Dismiss"));
  const box = make("div", { class: `toast glass ${kind}`, role: kind === "fault" ? "alert" : "status" }, make("p", {}, words), close);
  const gone = (): void => box.remove();
  let timer = setTimeout(gone, STAY_MS[kind]);
  const hold = (): void => clearTimeout(timer);
  const release = (): void => void (timer = setTimeout(gone, STAY_MS[kind]));
  close.addEventListener("click", gone);
  box.addEventListener("pointerenter", hold);
  box.addEventListener("pointerleave", release);
  box.addEventListener("focusin", hold);
  box.addEventListener("focusout", release);
  region.append(box);
  while (region.children.length > MOST) region.firstElementChild!.remove();
  return gone;
}
