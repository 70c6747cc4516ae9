"""``moveset inspect``: what is in files of any kind."""

import json

import pytest
import torch

from moveset.cli.__main__ import main
from moveset.io import save
from moveset.io.bvh import write_bvh
from moveset.io.contents import inspect
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.retarget import retarget
from moveset.motion.rigs import RIGS
from moveset.motion.skeleton import Skeleton
from tests.io.foreign import in_units
from tests.motions import gait


@pytest.fixture(scope="module")
def walk():
    return gait(41)


@pytest.mark.parametrize("name", ["a.bvh", "a.glb", "a.gltf", "a.vrma", "a.npz", "a.amass.npz", "a.npy", "a.html"])
def test_own_files_of_every_kind(walk, name, tmp_path):
    save(walk, tmp_path / name, metadata={"prompt": "walks"})
    found = inspect(tmp_path / name)
    assert (found.frames, found.fps, found.seconds) == (41, 20.0, pytest.approx(2.05))
    assert (found.up, found.facing, found.stands) == ("y", "z", "rest pose")
    assert found.unit == (0.01 if name == "a.bvh" else 1.0)
    assert found.height == pytest.approx(1.55, abs=0.1)
    assert found.floor == pytest.approx(0.0, abs=0.01)
    assert found.travel == pytest.approx(2.0, abs=0.05)
    assert len(found.roles) == 22
    assert found.metadata["prompt"] == "walks"
    assert found.warnings == ()
    assert found.animations == (("walks",) if name in ("a.glb", "a.gltf", "a.vrma") else ())


@pytest.mark.parametrize("rig", RIGS)
def test_roles_are_named(walk, rig, tmp_path):
    made = retarget(walk, rig)
    found = inspect(save(made, tmp_path / "a.bvh"))
    assert set(found.joints) == set(made.skeleton.joints)
    assert {found.roles[role] for role in ("left_knee", "right_wrist")} <= set(made.skeleton.joints)


def test_other_axes_and_units_are_found_and_what_becomes_of_them(walk, tmp_path, capsys):
    """Z up, facing -Y, in inches: every offset and the world turned."""
    turn = rotations.about("x", 90.0)
    body = walk.skeleton
    turned = Skeleton("z", body.joints, body.parents, rotations.rotate(turn, body.offsets), body.pairs, body.feet)
    local = rotations.mul(rotations.mul(turn, walk.rotations), rotations.inv(turn))
    given = Motion(local, rotations.rotate(turn, walk.root), 20.0, turned)
    path = in_units(write_bvh(given, tmp_path / "a.bvh"), 0.0254)
    text = path.read_text().splitlines()
    # Without the ends that say the unit of our own files.
    ends = [k for k, line in enumerate(text) if "End Site" in line]
    for k in ends:
        text[k + 2] = text[k + 2].split("OFFSET")[0] + "OFFSET 0 0 1"
    path.write_text("\n".join(text) + "\n")
    found = inspect(path)
    assert (found.up, found.facing) == ("z", "-y")
    assert found.unit == pytest.approx(0.0254, rel=0.01)
    assert found.height == pytest.approx(1.55, abs=0.1)
    assert main(["inspect", str(path)]) == 0
    said = capsys.readouterr().out
    for words in ("41 at 20 fps", "0.0254 m", "up z, rest pose facing -y", "turn z up to y up", "left_knee"):
        assert words in said


def test_what_is_no_body_is_told_too(tmp_path, capsys):
    crane = Skeleton("crane", ("base", "arm", "hook"), (-1, 0, 1), torch.eye(3))
    path = save(Motion(rotations.identity(5, 3), torch.zeros(5, 3), 1000.0, crane), tmp_path / "a.glb")
    assert main(["inspect", str(path), "--json"]) == 0
    out, err = capsys.readouterr()
    found = json.loads(out)
    assert err == ""
    assert (found["roles"], found["up"], found["stands"]) == ({}, None, None)
    assert any("unusual" in line for line in found["warnings"])
    assert any("--skeleton fails" in line for line in found["convert"])
    assert main(["inspect", str(path), "--source-fps", "30", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert (found["fps"], found["warnings"]) == (30.0, [])


@pytest.mark.parametrize(("name", "message"), [("none.bvh", "none.bvh"), ("a.fbx", "Blender"), ("a.glb", "GLB")])
def test_what_cannot_be_read_is_said_in_one_line(tmp_path, capsys, name, message):
    (tmp_path / "a.glb").write_bytes(b"hello")
    assert main(["inspect", str(tmp_path / name)]) == 2
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1
