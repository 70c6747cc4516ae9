// Writes src/moveset/viewer/build.json: what the builds were made of and what they are, so that a test can tell
// whether they still belong together. tests/viewer/test_build.py computes both in Python.
import { createHash } from "node:crypto";
import { readdirSync, readFileSync, writeFileSync } from "node:fs";
import { join, relative, sep } from "node:path";
import { fileURLToPath } from "node:url";

const here = fileURLToPath(new URL(".", import.meta.url));
const built = join(here, "../src/moveset/viewer");
const sha256 = (data) => createHash("sha256").update(data).digest("hex");

function files(folder) {
  return readdirSync(folder, { recursive: true, withFileTypes: true })
    .filter((entry) => entry.isFile())
    .map((entry) => join(entry.parentPath, entry.name));
}

function hashes(root, paths) {
  const named = paths.map((path) => [relative(root, path).split(sep).join("/"), sha256(readFileSync(path))]);
  return Object.fromEntries(named.sort(([a], [b]) => (a < b ? -1 : 1)));
}

const single = ["index.html", "package.json", "package-lock.json", "tsconfig.json", "manifest.mjs"];
const configs = ["vite.player.config.ts", "vite.studio.config.ts"];
const sources = hashes(here, [...files(join(here, "src")), ...[...single, ...configs].map((name) => join(here, name))]);
const outputs = hashes(built, [...files(join(built, "player")), ...files(join(built, "studio"))]);
writeFileSync(join(built, "build.json"), JSON.stringify({ sources, outputs }, null, 1) + "\n");
