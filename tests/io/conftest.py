"""Oracles that run in node."""

import hashlib
import json
import shutil
import subprocess
import tempfile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("gltf-validator", "three", "@pixiv/three-vrm-animation")


@pytest.fixture(scope="session")
def node():
    """Runs a script beside the tests in node with arguments, the packages of package.json at hand; returns its JSON."""
    if not (shutil.which("node") and shutil.which("npm")):
        pytest.skip("no node and npm here to run the oracles with")
    modules = _modules()

    def run(script: str, *arguments: object):
        # Node looks for packages beside the script.
        home = modules.parent / script
        shutil.copyfile(Path(__file__).parent / script, home)
        command = ["node", str(home), *map(str, arguments)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
        assert done.returncode == 0, done.stderr[-2000:]
        return json.loads(done.stdout)

    return run


def _modules() -> Path:
    """node_modules of the repository where somebody has installed them, else of a cache folder."""
    wanted = (ROOT / "package.json").read_bytes()
    cache = Path(tempfile.gettempdir()) / f"moveset-node-{hashlib.sha256(wanted).hexdigest()[:16]}"
    for modules in (ROOT / "node_modules", cache / "node_modules"):
        if all((modules / name / "package.json").is_file() for name in PACKAGES):
            break
    else:
        with tempfile.TemporaryDirectory(prefix="moveset-node-", dir=cache.parent) as scratch:
            Path(scratch, "package.json").write_bytes(wanted)
            command = ["npm", "install", "--no-audit", "--no-fund", "--no-package-lock"]
            done = subprocess.run(command, cwd=scratch, capture_output=True, text=True, timeout=240, check=False)
            if done.returncode:
                pytest.skip(f"npm cannot install the oracles here: {done.stderr.strip()[-200:]}")
            if not cache.exists():
                shutil.copytree(scratch, cache)
        modules = cache / "node_modules"
    if modules.parent == ROOT:
        # Scripts are copied beside the packages; keep the repository clean.
        place = Path(tempfile.mkdtemp(prefix="moveset-node-scripts-")) / "node_modules"
        place.symlink_to(modules, target_is_directory=True)
        return place
    return modules
