"""The mannequin: closed, on the floor, turned as its skeleton is, and there for skeletons of any size."""

import warnings
from dataclasses import replace

import numpy as np
import pytest
import torch

from moveset.io import load, save
from moveset.io.body import human_body
from moveset.io.body_mesh import body_meshes
from moveset.io.filmstrip import filmstrip
from moveset.motion.retarget import retarget
from moveset.motion.rigs import RIGS
from tests.motions import wander


@pytest.mark.parametrize("rig", ["hml22", "mixamo", "ue5"])
def test_body_is_closed_faces_outwards_and_stands_on_the_floor(rig):
    skeleton = RIGS[rig]
    floor = float(skeleton.rest_positions[:, 1].min())
    lowest = np.inf
    for mesh in body_meshes(skeleton).values():
        edges = np.concatenate([mesh.triangles[:, pair] for pair in ((0, 1), (1, 2), (2, 0))])
        there, back = ({tuple(e) for e in way.tolist()} for way in (edges, edges[:, ::-1]))
        assert there == back, "every edge is shared by two triangles that run along it in opposite ways"
        a, b, c = (mesh.positions[mesh.triangles[:, k]] for k in range(3))
        face = np.cross(b - a, c - a)
        assert (np.einsum("ij,ij->i", face, mesh.normals[mesh.triangles].sum(axis=1)) > 0).all()
        np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1.0, atol=1e-5)
        lowest = min(lowest, float(mesh.positions[:, 1].min()))
    assert lowest == pytest.approx(floor, abs=0.012)


def test_hands_of_a_rig_that_faces_backward_are_turned_with_it():
    rig, half_turn = RIGS["mixamo"], np.array([-1.0, 1.0, -1.0])
    back = replace(rig, offsets=rig.offsets * torch.tensor(half_turn).float())
    hand = rig.index("mixamorig:LeftHand")
    ours, theirs = ([part for part in human_body(body) if part.joint == hand] for body in (rig, back))
    assert len(ours) == 2
    for one, other in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(other.frame @ other.start, half_turn * (one.frame @ one.start), atol=1e-6)
        np.testing.assert_allclose(other.frame @ other.end, half_turn * (one.frame @ one.end), atol=1e-6)


@pytest.mark.parametrize("what", ["faces backward", "no forearm", "no bones"])
def test_a_skeleton_of_odd_bones_is_shown(what, tmp_path):
    rig = RIGS["mixamo"]
    offsets = rig.offsets * {"faces backward": torch.tensor([-1.0, 1.0, -1.0]), "no bones": 0.0}.get(what, 1.0)
    if what == "no forearm":
        offsets[rig.index("mixamorig:LeftHand")] = 0.0
    made = replace(retarget(wander(5, seed=1), rig), skeleton=replace(rig, name="odd", offsets=offsets))
    for mesh in body_meshes(made.skeleton).values():
        assert np.isfinite(mesh.positions).all()
        assert np.isfinite(mesh.normals).all()
    assert (load(save(made, tmp_path / "a.glb")).joints - made.joints).abs().max() < 1e-4
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # of numbers that are none
        filmstrip(made, poses=2)
