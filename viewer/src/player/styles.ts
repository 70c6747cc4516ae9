/** Style rules of the player; colours hang on data-theme of its root. */

export const PLAYER_CSS = `
.moveset-player { --mv-ink: #1d2430; --mv-soft: #5b6678; --mv-glass: rgba(255,255,255,.78); --mv-edge: rgba(30,40,60,.10);
  --mv-hover: rgba(40,52,76,.08); --mv-track: rgba(40,52,76,.18); --mv-accent: #6a5cc2; --mv-on: rgba(106,92,194,.14);
  --mv-back: #e6eaf0; --mv-lift: 0 6px 24px rgba(30,40,60,.12), 0 1px 3px rgba(30,40,60,.10);
  position: relative; overflow: hidden; width: 100%; height: 100%; min-height: 180px; background: var(--mv-back); color: var(--mv-ink);
  font: 14px/1.4 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; outline: none;
  -webkit-tap-highlight-color: transparent; container: moveset-player / inline-size; }
.moveset-player[data-theme=dark] { --mv-ink: #e9edf4; --mv-soft: #9aa7bb; --mv-glass: rgba(31,36,46,.80); --mv-edge: rgba(200,215,240,.12);
  --mv-hover: rgba(200,215,240,.10); --mv-track: rgba(200,215,240,.22); --mv-accent: #a79bf5; --mv-on: rgba(167,155,245,.20);
  --mv-back: #161a21; --mv-lift: 0 8px 28px rgba(0,0,0,.45); }
.moveset-player *, .moveset-player *::before { box-sizing: border-box; }
.moveset-player canvas { position: absolute; inset: 0; width: 100%; height: 100%; display: block; touch-action: none; cursor: grab; }
.moveset-player canvas:active { cursor: grabbing; }
.moveset-player:focus-visible::after { content: ""; position: absolute; inset: 0; border: 2px solid var(--mv-accent); border-radius: inherit;
  pointer-events: none; }
.mv-labels { position: absolute; inset: 0; overflow: hidden; pointer-events: none; }
/* Drawn by a processor: blurring what moves under glass costs as much as drawing it. */
.moveset-player[data-software] :is(.mv-caption, .mv-bar) { backdrop-filter: none; }
.mv-label { position: absolute; left: 0; top: 0; max-width: 16em; padding: 2px 10px; border-radius: 99px; background: var(--mv-glass);
  border: 1px solid var(--mv-edge); font-size: 12.5px; font-weight: 550; white-space: nowrap; overflow: hidden; text-overflow: ellipsis; }
.mv-caption { position: absolute; left: 50%; top: 14px; translate: -50% 0; width: max-content; max-width: calc(100% - 28px); padding: 7px 16px;
  border-radius: 14px; background: var(--mv-glass); border: 1px solid var(--mv-edge); backdrop-filter: blur(14px); box-shadow: var(--mv-lift);
  font-weight: 550; text-align: center; overflow-wrap: anywhere; pointer-events: none; }
.mv-caption:empty { display: none; }
.mv-bar { position: absolute; left: 50%; bottom: 14px; translate: -50% 0; display: flex; align-items: center; gap: 4px; width: calc(100% - 28px);
  max-width: 860px; padding: 6px 8px; border-radius: 16px; background: var(--mv-glass); border: 1px solid var(--mv-edge);
  backdrop-filter: blur(14px); box-shadow: var(--mv-lift); }
.mv-button, .mv-speed { flex: none; display: inline-grid; place-items: center; height: 36px; min-width: 36px; padding: 0; border: 0; border-radius: 10px;
  background: transparent; color: var(--mv-soft); font: inherit; font-size: 13px; font-weight: 600; cursor: pointer; transition: background .12s, color .12s; }
.mv-button:hover, .mv-speed:hover { background: var(--mv-hover); color: var(--mv-ink); }
.mv-button:focus-visible, .mv-speed:focus-visible, .mv-scrub input:focus-visible { outline: 2px solid var(--mv-accent); outline-offset: 1px; }
.mv-button[aria-pressed=true] { background: var(--mv-on); color: var(--mv-accent); }
.mv-button svg { width: 20px; height: 20px; fill: none; stroke: currentColor; stroke-width: 1.8; stroke-linecap: round; stroke-linejoin: round;
  grid-area: 1 / 1; }
.mv-button svg.mv-filled { fill: currentColor; stroke: none; }
.mv-play { color: var(--mv-ink); }
.mv-play[data-playing=true] svg:first-child, .mv-play:not([data-playing=true]) svg:last-child { display: none; }
.mv-record { color: #d2473d; }
.mv-record[aria-pressed=true] { color: #fff; background: #d2473d; animation: mv-pulse 1.2s ease-in-out infinite; }
@keyframes mv-pulse { 50% { opacity: .55; } }
.mv-speed { appearance: none; padding: 0 8px; text-align: center; text-align-last: center; font-variant-numeric: tabular-nums; }
.mv-speed option { color: #1d2430; background: #fff; }
.mv-time { flex: none; min-width: 5.4em; padding: 0 4px; color: var(--mv-soft); font-size: 12.5px; font-variant-numeric: tabular-nums; text-align: right;
  white-space: nowrap; }
.mv-time b { color: var(--mv-ink); font-weight: 600; }
.mv-scrub { position: relative; flex: 1 1 120px; min-width: 80px; height: 36px; margin: 0 6px; }
.mv-scrub input { position: absolute; inset: 0; width: 100%; height: 100%; margin: 0; background: none; appearance: none; cursor: pointer; border-radius: 8px; }
.mv-scrub input::-webkit-slider-runnable-track { height: 5px; border-radius: 3px;
  background: linear-gradient(to right, var(--mv-accent) var(--mv-done, 0%), var(--mv-track) var(--mv-done, 0%)); }
.mv-scrub input::-webkit-slider-thumb { appearance: none; width: 15px; height: 15px; margin-top: -5px; border-radius: 50%; background: var(--mv-accent);
  box-shadow: 0 0 0 3px var(--mv-glass), 0 1px 4px rgba(0,0,0,.3); }
.mv-scrub input::-moz-range-track { height: 5px; border-radius: 3px; background: var(--mv-track); }
.mv-scrub input::-moz-range-progress { height: 5px; border-radius: 3px; background: var(--mv-accent); }
.mv-scrub input::-moz-range-thumb { width: 15px; height: 15px; border: 0; border-radius: 50%; background: var(--mv-accent); }
.mv-mark { position: absolute; top: 50%; width: 3px; height: 15px; padding: 0; border: 0; border-radius: 2px; background: var(--mv-soft); translate: -50% -50%;
  cursor: pointer; }
.mv-mark::before { content: ""; position: absolute; inset: -6px -5px; }
.mv-mark:hover, .mv-mark:focus-visible { background: var(--mv-accent); outline: none; height: 19px; }
.mv-gap { flex: none; width: 1px; height: 20px; margin: 0 3px; background: var(--mv-edge); }
.mv-fault { position: absolute; inset: 0; display: grid; place-items: center; padding: 24px; text-align: center; color: var(--mv-soft); }
@container moveset-player (max-width: 700px) {
  .mv-bar { flex-wrap: wrap; justify-content: space-around; gap: 2px; }
  .mv-play { order: -3; }
  .mv-scrub { order: -2; flex: 1 1 55%; }
  .mv-time { order: -1; }
  .mv-gap { display: none; }
  .mv-caption { font-size: 13px; }
}
@container moveset-player (max-width: 430px) { .mv-button { min-width: 32px; } .mv-speed { padding: 0 4px; } .mv-time { min-width: 4.6em; } }
@media (prefers-reduced-motion: reduce) { .moveset-player * { transition: none !important; animation: none !important; } }
`;
