"""The front door: the weights that ship, from a sentence to files, in processes of their own."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

from moveset import TextToMotion
from moveset.io import load
from moveset.pipelines.bundle import DEFAULT_MODEL, Bundle, shipped

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("0*.py"))
SEEDS = range(5)


@pytest.fixture(scope="module")
def t2m():
    return TextToMotion.from_pretrained(device="cpu")


def test_what_ships_is_whole_and_small():
    assert DEFAULT_MODEL in shipped()
    assert sum(Bundle(path).verify() for path in shipped().values()) <= 80e6


def test_every_method_ships():
    config = Bundle.find(DEFAULT_MODEL).config
    assert config.name == DEFAULT_MODEL
    assert config.steps("pcm") == (1, 2, 4)
    assert config.steps("lcm") == (1,)
    assert "teacher" in config.models
    assert config.provenance


def test_a_whole_process(tmp_path):
    command = ["generate", "a person walks forward and waves", "-o", "w.bvh", "-o", "w.glb", "--seed", "7", "--json"]
    done = subprocess.run(
        [sys.executable, "-m", "moveset.cli", *command], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    report = json.loads(done.stdout)
    assert report["files"] == ["w.bvh", "w.glb"]
    assert 2.0 <= report["seconds"] <= 9.8
    bvh, glb = load(tmp_path / "w.bvh"), load(tmp_path / "w.glb")
    assert float((bvh.joints - glb.joints).abs().max()) < 1e-4


@pytest.mark.parametrize("steps", [1, 2, 4])
def test_a_walk_goes_forward(t2m, steps):
    gone = [float(m.root[-1, 2] - m.root[0, 2]) for m in (made(t2m, "a person walks forward", steps, s) for s in SEEDS)]
    assert sorted(gone)[len(gone) // 2] > 1.5, gone


@pytest.mark.parametrize("steps", [1, 2, 4])
@pytest.mark.parametrize("side", ["left", "right"])
def test_a_wave_lifts_the_hand_it_names(t2m, steps, side):
    other = {"left": "right", "right": "left"}[side]
    prompt = f"a person waves with the {side} hand"
    lifted = [reach(motion, side) - reach(motion, other) for motion in (made(t2m, prompt, steps, s) for s in SEEDS)]
    assert sum(lift > 0.2 for lift in lifted) >= 3, lifted


def test_bodies_stand_on_the_floor(t2m):
    for prompt in ("a person walks forward", "a person bows", "someone runs fast"):
        joints = made(t2m, prompt, 1, 3).joints
        assert 1.3 < float(joints[0, :, 1].max()) < 1.9
        assert -0.1 < float(joints[..., 1].min()) < 0.1


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_examples_run(example, tmp_path):
    done = subprocess.run([sys.executable, str(example)], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert done.stdout


def made(t2m, prompt, steps, seed):
    return t2m(prompt, seconds=4.0, steps=steps, seed=seed).motion


def reach(motion, side):
    """Highest point of a wrist, metres."""
    return float(motion.joints[:, motion.skeleton.index(f"{side}_wrist"), 1].max())
