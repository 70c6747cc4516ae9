/** The studio page: puts its parts together and decides which mode hears what is typed. */
import { generate, models as askModels, type ModelInfo, type Models, prompts as askPrompts } from "./api";
import { Clip, suggest } from "./clip";
import { byId, make, roving } from "./dom";
import { Downloads } from "./downloads";
import { Live } from "./live";
import { back, fault, made, notice, phase, watchReconnect } from "./page";
import { Popover } from "./popover";
import { Recent } from "./recent";
import { shortcuts } from "./shortcuts";
import { fromAnswer } from "./shown";
import { Stage } from "./stage";
import { theme, themes } from "./theme";
import { toast } from "./toasts";

type Mode = "clip" | "live";

const stage = new Stage(byId("stage"), theme(), document.querySelector<HTMLElement>(".top")!, () => {
  // The greeting is not to be stood on; later, only the prompt box counts, so that the figure keeps its place.
  return document.querySelector<HTMLElement>('body[data-phase="empty"] .dock') ?? byId("composer");
});
const prompt = byId<HTMLTextAreaElement>("prompt");
const still = matchMedia("(prefers-reduced-motion: reduce)");
let mode: Mode = "clip";
let server: Models | null = null;
const models: Partial<Record<Mode, string>> = {};

const downloads = new Downloads({
  shown: () => stage.shown,
  live: () => stage.player.live,
  record: () => stage.player.recordVideo(),
});

const recent = new Recent((kept) => {
  live.leave();
  clip.leave();
  if (kept.entries.length) {
    enter("clip");
    clip.restore(kept.entries, kept.shown.takes[0].seed);
  }
  notice([]);
  made("");
  stage.show(kept.shown, true);
  downloads.enable(true);
  byId("live-strip").hidden = true;
});

const clip = new Clip({
  made(shown, entries) {
    if (mode !== "clip") return;
    stage.show(shown, true);
    recent.add({ shown, entries });
    downloads.enable(true);
  },
});

const live = new Live({
  begun(shown) {
    stage.follow(shown);
    downloads.enable(true);
  },
  grown: () => stage.grown(),
  kept: (shown) => recent.add({ shown, entries: [] }),
  playing: (on) => (on ? stage.player.play() : stage.player.pause()),
  ended: () => stage.settle(),
});

stage.onFrame((frame) => {
  const shown = stage.shown;
  if (mode === "live") return void (shown === live.shown && live.at(frame));
  if (!shown || clip.timeline.entries.length < 2) return;
  const { take, prompts } = shown.takes[0];
  const entry = prompts.findLastIndex((mark) => mark.firstFrame <= frame);
  if (entry < 0 || prompts.length !== clip.timeline.entries.length) return clip.timeline.playing(null);
  const begun = prompts[entry].firstFrame;
  const end = prompts[entry + 1]?.firstFrame ?? take.frames;
  clip.timeline.playing({ entry, share: Math.min(1, (frame - begun) / (end - begun)) });
});

/** Enter a mode. A stream ends when one leaves it, and stays among the recent takes. */
function enter(wanted: Mode): void {
  if (wanted === mode) return;
  live.leave();
  clip.leave();
  mode = wanted;
  document.body.dataset.mode = mode;
  for (const one of ["clip", "live"] as const) {
    const button = byId(`mode-${one}`);
    button.setAttribute("aria-checked", String(one === mode));
    button.tabIndex = one === mode ? 0 : -1;
    byId(`${one}-settings`).hidden = one !== mode;
  }
  notice([]);
  made("");
  byId("live-strip").hidden = byId("timeline").hidden = true;
  byId("go-label").textContent = "Move";
  suggestAnew();
  if (mode === "clip") return clip.restore(clip.timeline.entries);
  live.label();
}

/** Suggest what the mode's model does well. */
async function suggestions(): Promise<string[]> {
  const model = models[mode];
  if (!model) return [];
  const known = await askPrompts(model);
  back();
  // Another model may be in use by now, and its answer may have come first.
  if (model === models[mode]) suggest(known, say);
  return known;
}

function suggestAnew(): void {
  suggestions().catch((thrown) => fault(thrown, suggestAnew));
}

function submit(): void {
  if (mode === "clip") return void clip.submit();
  const text = prompt.value;
  prompt.value = "";
  grow();
  live.say(text);
}

function say(text: string): void {
  if (mode === "clip") clip.say(text);
  else live.say(text);
}

/** The prompt box is as high as its words, up to five lines (its style says so). */
function grow(): void {
  prompt.style.height = "auto";
  prompt.style.height = `${prompt.scrollHeight}px`;
  document.body.classList.toggle("silent", !prompt.value);
}

prompt.addEventListener("input", () => {
  grow();
  if (mode === "clip") clip.typed();
});
prompt.addEventListener("keydown", (event) => {
  if (event.key !== "Enter" || event.shiftKey || event.isComposing) return;
  event.preventDefault();
  if ((event.ctrlKey || event.metaKey) && mode === "clip") clip.add();
  else submit();
});
byId("composer").addEventListener("submit", (event) => {
  event.preventDefault();
  submit();
});
byId("open-settings").addEventListener("click", () => {
  const open = document.body.classList.toggle("settings-open");
  byId("open-settings").setAttribute("aria-expanded", String(open));
});
for (const one of ["clip", "live"] as const) byId(`mode-${one}`).addEventListener("click", () => enter(one));
roving(byId("mode-clip").parentElement!, () => [byId("mode-clip"), byId("mode-live")]);
Popover.watch();
watchReconnect();

const switchTheme = themes((now) => (stage.theme = now));
stage.onstate = () => {
  if (stage.player.theme !== theme()) switchTheme();
  live.follow(stage.player.playing);
};
byId("open-theme").addEventListener("click", switchTheme);

shortcuts(
  [
    { key: "/", keys: "/", does: "Write a prompt", run: () => prompt.focus() },
    { key: "g", keys: "G", does: "Another try with another seed", run: () => mode === "clip" && clip.again() },
    { key: "1", keys: "1", does: "Clip", run: () => byId("mode-clip").click() },
    { key: "2", keys: "2", does: "Live", run: () => byId("mode-live").click() },
    { key: "x", keys: "X", does: "Stop the stream", run: () => live.stop() },
    { key: "h", keys: "H", does: "Hold on to the take so far", run: () => live.keep() },
    { key: "o", keys: "O", does: "Download", run: () => downloads.show() },
    { key: "d", keys: "D", does: "Light or dark", run: switchTheme },
    { key: "?", keys: "?", does: "This panel", run: () => byId("open-help").click() },
  ],
  (event) => stage.key(event),
);

/** Offer the models of a task, and use the default one. */
function offer(task: "clip" | "stream", use: (model: ModelInfo) => void): ModelInfo | null {
  const all = server!.models.filter((model) => model.task === task);
  const name = server!.default[task];
  const chosen = all.find((model) => model.name === name) ?? all[0];
  const key = task === "clip" ? "clip" : "live";
  const select = byId<HTMLSelectElement>(`${key}-model`);
  select.replaceChildren(...all.map((model) => make("option", { value: model.name }, model.name)));
  byId(`${key}-model-setting`).hidden = all.length < 2;
  byId<HTMLButtonElement>(`mode-${key}`).disabled = all.length === 0;
  if (!chosen) return null;
  select.value = chosen.name;
  select.onchange = () => {
    use(all.find((model) => model.name === select.value)!);
    suggestAnew();
  };
  use(chosen);
  return chosen;
}

/** Ask the server what it can, then greet with the first thing that it knows. */
async function begin(): Promise<void> {
  try {
    server = await askModels();
    downloads.offer(server);
    const clips = offer("clip", (model) => {
      models.clip = model.name;
      clip.use(model);
    });
    const streams = offer("stream", (model) => {
      models.live = model.name;
      live.use(model);
    });
    back();
    if (!clips && !streams) return void toast("The server has no models; see: moveset models", "fault");
    if (!clips) return enter("live");
    const known = await suggestions();
    if (known.length && !stage.shown) await greet(known.find((text) => /\bwav/.test(text)) ?? known[0]);
  } catch (thrown) {
    fault(thrown, () => void begin());
  }
}

/** The first suggestion, played once as a greeting: the stage is not empty while somebody thinks of a sentence. */
async function greet(text: string): Promise<void> {
  const request = { prompts: [{ text, seconds: null }], model: null, steps: null, seed: 1, num: 1 };
  const answer = await generate(request, new AbortController().signal);
  if (!stage.shown && document.body.dataset.phase === "empty") stage.show(fromAnswer(answer), !still.matches);
}

phase("idle");
grow();
// For tests and for the curious: what is on the stage, to be read and not to be changed.
Object.assign(window, { __moveset: { player: stage.player, stage, clip, live, recent } });
void begin();
