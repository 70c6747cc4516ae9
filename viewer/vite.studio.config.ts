// The page that `moveset serve` opens, with its files under /assets.
import { defineConfig } from "vite";

export default defineConfig({
  publicDir: false,
  build: {
    outDir: "../src/moveset/viewer/studio",
    emptyOutDir: true,
    target: "es2022",
    // Content-Security-Policy allows no inline script, style or data: font.
    assetsInlineLimit: 0,
    modulePreload: { polyfill: false },
  },
  server: { proxy: { "/v1": { target: "http://127.0.0.1:8765", ws: true } } },
});
