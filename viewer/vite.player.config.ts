// The player alone: one classic script with the global `MovesetPlayer`, for pages that must work as a single file.
import { defineConfig } from "vite";

export default defineConfig({
  publicDir: false,
  build: {
    outDir: "../src/moveset/viewer/player",
    emptyOutDir: true,
    target: "es2022",
    lib: { entry: "src/embed.ts", formats: ["iife"], name: "MovesetPlayer", fileName: () => "player.js" },
    // Never "</script" or "<!--" inside: the script is put into pages as it is (tests/viewer checks the built file).
    rolldownOptions: { output: { codeSplitting: false } },
  },
});
