"""The pages that are shipped are made of the sources that are here: both are remembered by their hashes."""

import hashlib
import json
from importlib import resources
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
VIEWER = ROOT / "viewer"
BUILT = Path(str(resources.files("moveset"))) / "viewer"
SINGLE = ("index.html", "package.json", "package-lock.json", "tsconfig.json", "manifest.mjs")
CONFIGS = ("vite.player.config.ts", "vite.studio.config.ts")


def hashes(root, paths):
    return {path.relative_to(root).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}


def files(folder):
    return [path for path in folder.rglob("*") if path.is_file()]


@pytest.fixture(scope="module")
def remembered():
    return json.loads((BUILT / "build.json").read_text())


def test_the_builds_are_of_these_sources(remembered):
    sources = hashes(VIEWER, [*files(VIEWER / "src"), *(VIEWER / name for name in (*SINGLE, *CONFIGS))])
    assert sources == remembered["sources"], "run `make viewer` and commit what it changes"


def test_the_builds_are_as_they_were_made(remembered):
    outputs = hashes(BUILT, [*files(BUILT / "player"), *files(BUILT / "studio")])
    assert outputs == remembered["outputs"], "run `make viewer` and commit what it changes"


def test_the_builds_are_small_and_call_nobody():
    assert (BUILT / "player" / "player.js").stat().st_size < 1_000_000
    for path in files(BUILT):
        text = path.read_bytes()
        assert b"https://" not in text, path
        assert b"//cdn" not in text, path
