// The player alone: one classic script with the global `MovesetPlayer`, for pages that must work as a single file.
import { defineConfig } from "vite";

export default defineConfig({
  publicDir: false,
  build: {
    outDir: "../src/moveset/viewer/player",
    emptyOutDir: true,
    target: "es2022",
    lib: { entry: "src/standalone.ts", formats: ["iife"], name: "MovesetPlayer", fileName: () => "player.js" },
    rolldownOptions: { output: { codeSplitting: false } },
  },
});
