"""Blender imports what we write and sees the joints where we have them; we read what Blender exports.

Runs where a Python with bpy is at hand: this one, or that of the environment variable MOVESET_BPY_PYTHON.
"""

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from moveset.io import load, save
from moveset.motion.retarget import retarget
from tests.motions import wander

SCRIPT = Path(__file__).with_name("import_joints.py")


@pytest.fixture(scope="module")
def blender():
    python = os.environ.get("MOVESET_BPY_PYTHON")
    if python is None and importlib.util.find_spec("bpy") is None:
        pytest.skip("no bpy here: pip install bpy, or name a Python that has it in MOVESET_BPY_PYTHON")

    def joints(path, names, fps):
        target = path.with_suffix(f"{path.suffix}.npy")
        command = [python or sys.executable, str(SCRIPT), str(path), json.dumps(list(names)), str(fps), str(target)]
        done = subprocess.run(command, capture_output=True, text=True, timeout=200, check=False)
        assert done.returncode == 0, done.stderr[-2000:]
        return np.load(target, allow_pickle=False)

    return joints


@pytest.mark.parametrize("rig", ["hml22", "kit21", "smpl", "mixamo", "vrm", "ue5"])
def test_blender_sees_the_same_joints_in_every_file_that_it_reads(blender, rig, tmp_path):
    motion = retarget(wander(30, seed=8, turn=1.0), rig)
    names = motion.skeleton.joints
    seen = {}
    for suffix in (".glb", ".gltf", ".bvh"):
        save(motion, tmp_path / f"a{suffix}")
        seen[suffix] = blender(tmp_path / f"a{suffix}", names, motion.fps)
        assert seen[suffix].shape == (30, len(names), 3)
        assert np.abs(seen[suffix] - motion.joints.numpy()).max() < 1e-4
    assert np.abs(seen[".glb"] - seen[".bvh"]).max() < 1e-4
    # Blender turns bones as it likes and exports them so: a file of another program, with the same motion.
    again = load(tmp_path / "a.glb-again.glb")
    order = [again.skeleton.joints.index(name) for name in names]
    frames = min(len(again), 30)
    assert frames >= 29
    offset = 0 if len(again) == 30 else 1
    assert (
        np.abs(again.joints[:, order].numpy()[:frames] - motion.joints.numpy()[offset : offset + frames]).max() < 1e-3
    )
