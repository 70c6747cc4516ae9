"""The add-on in a real Blender shows the joints where moveset has them, and says what is wrong.

Runs where a Python with bpy is at hand: this one, or that of the environment variable MOVESET_BPY_PYTHON.
"""

import base64
import importlib.util
import json
import os
import re
import subprocess
import sys
import urllib.request
import zipfile
from pathlib import Path

import numpy as np
import pytest

from moveset.io.packets import pack_packet, unpack_packets
from moveset.motion.retarget import retarget
from moveset.motion.rigs import get_rig
from tests.motions import gait, wander

ROOT = Path(__file__).resolve().parents[2]
ADD_ON = ROOT / "integrations" / "blender"


@pytest.fixture(scope="module")
def python():
    found = os.environ.get("MOVESET_BPY_PYTHON")
    if found is None and importlib.util.find_spec("bpy") is None:
        pytest.skip("no bpy here: pip install bpy, or name a Python that has it in MOVESET_BPY_PYTHON")
    return found or sys.executable


@pytest.fixture(scope="module")
def motions():
    walk = wander(40, seed=5, bend=0.6, turn=1.5)
    return {"walk": walk, "stream": gait(60), "mixamo": retarget(walk, "mixamo"), "ue5": retarget(walk, "ue5")}


@pytest.fixture(scope="module")
def blender(python, motions, served, tmp_path_factory):
    """What Blender shows (name -> joints) and says (name -> sentence)."""
    folder = tmp_path_factory.mktemp("blender")
    for name in ("walk", "mixamo", "ue5"):
        motions[name].save(folder / f"{name}.npz")
    with np.load(folder / "walk.npz") as npz:
        joints = [f"{joint}{'_' * 80 * (joint == 'head')}" for joint in npz["joints"]]
        np.savez(folder / "long.npz", **(dict(npz) | {"joints": np.array(joints)}))
    stream = motions["stream"]
    packets = [pack_packet(stream[a : a + 28], first_frame=a) for a in range(0, len(stream), 28)]
    (folder / "stream.mvst").write_bytes(b"".join(packets))
    script = Path(__file__).with_name("in_blender.py")
    done = subprocess.run(
        [python, str(script), str(ADD_ON), str(folder), served],
        capture_output=True,
        text=True,
        timeout=280,
        check=False,
    )
    assert done.returncode == 0, (done.stdout + done.stderr)[-3000:]
    with np.load(folder / "joints.npz", allow_pickle=False) as npz:
        return dict(npz), json.loads((folder / "said.json").read_text())


def in_blender(joints):
    """Z up, facing -Y."""
    x, y, z = np.moveaxis(np.asarray(joints, dtype=np.float64), -1, 0)
    return np.stack((x, -z, y), axis=-1)


def apart(a, b):
    """Largest distance of a joint, metres; shown by pytest -rP."""
    assert a.shape == b.shape
    largest = np.linalg.norm(a - b, axis=-1).max()
    print(f"largest error of a joint: {largest:.2e} m")
    return largest


def test_a_take_is_where_moveset_has_it(blender, motions):
    shown, said = blender
    assert [said[f"import {rate}"] for rate in ("SET", "TAKE", "SCENE")] == [["FINISHED"]] * 3
    assert [said[f"fps {rate}"] for rate in ("SET", "TAKE", "SCENE")] == [20.0, 24.0, 30.0]
    assert apart(shown["SET"], in_blender(motions["walk"].joints)) < 1e-4
    assert apart(shown["TAKE"], in_blender(motions["walk"].joints)) < 1e-4
    assert apart(shown["SCENE"], in_blender(motions["walk"].resampled(30.0).joints)) < 1e-4
    assert apart(shown["stream.mvst"], in_blender(motions["stream"].joints)) < 1e-4
    for rig in ("mixamo", "ue5"):
        assert said[f"{rig}.npz"] == ["FINISHED"]
        assert apart(shown[f"{rig}.npz"], in_blender(motions[rig].joints)) < 1e-4


def test_bones_point_to_the_next_joint_and_roll_alike_on_both_sides(blender):
    _, said = blender
    axes = {name: np.array(axis).reshape(2, 3) for name, axis in said["bones"].items()}
    rest = get_rig("ue5")
    thigh = rest.offsets[rest.index("calf_l")].numpy()
    assert np.allclose(axes["thigh_l"][0], in_blender(thigh / np.linalg.norm(thigh)), atol=1e-5)
    for name in (name for name in axes if name.endswith("_l")):
        along, across = axes[name]
        mirrored = axes[name.removesuffix("l") + "r"]
        assert np.allclose(along * (-1, 1, 1), mirrored[0], atol=1e-5)
        assert np.allclose(across * (-1, 1, 1), mirrored[1], atol=1e-4)


def test_a_character_does_what_the_take_does_where_it_stands(blender, motions):
    shown, said = blender
    turn = np.array([[np.cos(0.7), -np.sin(0.7), 0.0], [np.sin(0.7), np.cos(0.7), 0.0], [0.0, 0.0, 1.0]])
    for rig in ("mixamo", "ue5"):
        assert said[f"onto {rig}"] == ["FINISHED"]
        wanted = retarget(motions["stream"], rig)
        there = 1.3 * in_blender(wanted.joints) @ turn.T + (2.0, -1.0, 0.0)
        assert apart(shown[f"onto {rig}"], there) < 1e-4


def test_an_armature_does_what_another_one_does(blender, motions):
    shown, said = blender
    assert (said["retarget"], said["sampled"]) == (["FINISHED"], [20.0, 60])
    # From a giant in A pose back to the size and pose that the take was made for; it looks ahead at rest.
    wanted = in_blender(retarget(motions["stream"], "mixamo").joints)
    # The giant stood two metres aside; from sampling on only the shape of its path counts.
    shift = shown["retarget"][0, 0] - wanted[0, 0]
    assert abs(shift[2]) < 1e-4
    assert apart(shown["retarget"], wanted + shift) < 2e-4
    assert said["again"] == ["FINISHED"]
    assert said["kept"] is True


def test_an_armature_that_moves_as_a_whole_takes_its_way_along(blender):
    shown, said = blender
    assert apart(shown["moved, sampled"], shown["moved"]) < 1e-4
    assert said["frame"] == 40


def test_joints_with_longer_names_than_bones_may_have_move(blender, motions):
    shown, said = blender
    assert said["long"] == ["FINISHED"]
    assert apart(shown["long"], in_blender(motions["walk"].joints)) < 1e-4


def test_errors_say_what_to_do(blender):
    _, said = blender
    assert said["fps left"] == 24
    for name, sentence in {
        "empty": "Empty has no bone recognisable as pelvis",
        "alone": "select the armature that moves",
        "uneven": r"Hero ue5 is scaled unevenly or mirrored; apply its scale",
        "stiff": "do not inherit rotation: mixamorig:RightArm",
        "no file": r"gone.mvst cannot be read",
        "camera": "no armature is active",
        "no prompt": "there is no prompt",
        "no server": "no moveset server answers at http://127.0.0.1:9",
        "elsewhere": "online access is switched off",
        "three steps": "steps",
    }.items():
        assert re.search(sentence, str(said[name])), (name, said[name])
        assert "Traceback" not in said[name]


def test_what_is_generated_is_what_the_server_makes(blender, served):
    shown, said = blender
    assert (said["generate"], said["seed 0"], said["seed 1"]) == (["FINISHED"], "5", "6")
    prompts = [("a person walks forward", 2.0), ("someone waves with the left hand", 1.5)]
    body = {"prompts": [{"text": t, "seconds": s} for t, s in prompts], "steps": 1, "seed": 5, "num": 2}
    request = urllib.request.Request(
        f"{served}/v1/generate", json.dumps(body).encode(), {"Content-Type": "application/json"}
    )
    with urllib.request.urlopen(request, timeout=60) as reply:
        takes = json.loads(reply.read())["takes"]
    for k, take in enumerate(takes):
        motion = unpack_packets(base64.b64decode(take["data"])).motion
        assert len(motion) == 70
        aside = np.array((1.5 * k, 0.0, 0.0))
        assert apart(shown[f"generated {k}"], in_blender(motion.joints) + aside) < 1e-4
    assert said["prompts"] == ["someone waves with the left hand"]


def test_blender_finds_the_zip_valid(python, tmp_path):
    build = [sys.executable, str(ADD_ON / "build.py"), "-o"]
    for folder in ("a", "b"):
        subprocess.run([*build, str(tmp_path / folder)], check=True, capture_output=True)
    first, second = (next((tmp_path / folder).iterdir()) for folder in ("a", "b"))
    assert first.read_bytes() == second.read_bytes()
    look = (
        "import importlib.util, pathlib; home = pathlib.Path(importlib.util.find_spec('bpy').origin).parent; "
        "print(*home.rglob('bl_pkg/cli/blender_ext.py'))"
    )
    found = subprocess.run([python, "-c", look], capture_output=True, text=True, timeout=200, check=True)
    done = subprocess.run(
        [python, found.stdout.strip(), "validate", str(first)], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    with zipfile.ZipFile(first) as archive:
        assert {"__init__.py", "blender_manifest.toml", "scene.py"} <= set(archive.namelist())
