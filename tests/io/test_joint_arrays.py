"""Arrays of positions and features: whose axes, whose joints, which rate."""

import json

import numpy as np
import pytest
import torch

from moveset.cli.__main__ import main
from moveset.errors import FormatError, InputError
from moveset.io import load, read_metadata, save
from moveset.motion.features import get_codec
from moveset.motion.retarget import retarget
from moveset.motion.rigs import RIGS, roles
from moveset.motion.skeleton import HML22
from tests.motions import gait, wander


@pytest.fixture(scope="module")
def motion():
    return wander(30, seed=4, turn=0.5)


def written(tmp_path, values):
    np.save(tmp_path / "a.npy", values)
    return tmp_path / "a.npy"


ORDERS = {
    "frames, joints, 3": lambda joints: joints,
    "joints, 3, frames": lambda joints: joints.transpose(1, 2, 0),
    "samples, joints, 3, frames": lambda joints: joints.transpose(1, 2, 0)[None],
    "samples, frames, joints, 3": lambda joints: joints[None],
    "Fortran's order": np.asfortranarray,
    "millimetres": lambda joints: 1000 * joints,
    "centimetres": lambda joints: 100 * joints,
    "joints of SMPL-H": lambda joints: np.concatenate((joints, np.repeat(joints[:, 20:21], 30, axis=1)), axis=1),
}


@pytest.mark.parametrize("order", ORDERS)
def test_axes_and_units_are_told_by_shape_and_size(motion, order, tmp_path):
    found = load(written(tmp_path, ORDERS[order](motion.joints.numpy())))
    assert (len(found), found.fps, len(found.skeleton)) == (30, 20.0, 22)
    assert (found.joints - motion.joints).abs().max() < 1e-3


@pytest.mark.parametrize("rig", RIGS)
def test_own_arrays_come_back_on_every_skeleton(motion, rig, tmp_path):
    made = retarget(motion, rig)
    found = load(save(made, tmp_path / "a.npy"))
    theirs, ours = roles(found.skeleton), roles(made.skeleton)
    both = [role for role in ours if role in theirs]
    assert len(both) >= 19
    gap = found.joints[:, [theirs[r] for r in both]] - made.joints[:, [ours[r] for r in both]]
    assert gap.abs().max() < 1e-3
    if rig in ("vrm", "kit21"):  # without the notes beside, bones that keep their length tell whose joints these are
        (tmp_path / "a.npy.json").unlink()
        assert (load(tmp_path / "a.npy").joints - found.joints).abs().max() < 1e-3


@pytest.mark.parametrize("fps", [12.5, 60.0])
def test_the_rate_is_kept_beside_the_array(motion, fps, tmp_path):
    path = save(motion.resampled(fps), tmp_path / "a.npy", metadata={"prompt": "walks"})
    assert read_metadata(path) == {"prompt": "walks", "fps": fps, "skeleton": "hml22"}
    assert load(path).fps == fps
    assert load(path, source_fps=24.0).fps == 24.0
    (tmp_path / "a.npy.json").write_text(json.dumps({"fps": "fast", "skeleton": 3}))
    assert load(path).fps == 20.0
    save(motion, path)
    assert load(path).fps == 20.0


@pytest.mark.parametrize(("kind", "rig"), [("hml", "hml22"), ("kit", "kit21")])
def test_features_are_decoded(kind, rig, tmp_path):
    codec = get_codec(kind)
    made = retarget(gait(40, fps=codec.fps), rig)
    features = codec.encode(made)
    joints = codec.joints(features.double()) * codec.reflection
    for values in (features, features[None], features.T[None, :, None]):  # the last as MDM arranges them
        found = load(written(tmp_path, values.numpy()))
        assert (found.fps, found.skeleton.joints) == (codec.fps, RIGS[rig].joints)
        assert (found.joints - joints).abs().max() < 2e-3
    normal = (features - features.mean(dim=0)) / features.std(dim=0).clamp_min(0.1)
    with pytest.raises(FormatError, match=r"normalised.*Std\.npy"):
        load(written(tmp_path, normal.numpy()))


def test_kit_ml_is_a_mirror_image_in_millimetres(tmp_path):
    made = retarget(gait(20), "kit21")
    found = load(written(tmp_path, 1000 * made.joints.numpy() * np.array([-1, 1, 1])))
    assert (found.joints - made.joints).abs().max() < 1e-3


def test_one_of_several_is_chosen_by_number(motion, tmp_path, capsys):
    other = wander(30, seed=5)
    batch = np.stack([m.joints.numpy().transpose(1, 2, 0) for m in (motion, other)])
    path = written(tmp_path, batch)
    with pytest.warns(UserWarning, match="2 motions, of which the first"):
        assert (load(path).joints - motion.joints).abs().max() < 1e-3
    assert main(["convert", str(path), str(tmp_path / "b.npz"), "--animation", "2"]) == 0
    assert capsys.readouterr().err == ""
    assert (load(tmp_path / "b.npz").joints - other.joints).abs().max() < 1e-3
    for wrong in ("0", "3", "-1", "Walk"):
        with pytest.raises(FormatError, match="from 1 to 2"):
            load(path, animation=wrong)
    with pytest.raises(InputError, match="hold one motion"):
        load(tmp_path / "b.npz", animation="1")


def test_pickles_are_named_and_never_read(motion, tmp_path):
    results = {"motion": motion.joints.numpy(), "lengths": [30]}
    np.save(tmp_path / "results.npy", np.array(results), allow_pickle=True)
    (tmp_path / "raw.npy").write_bytes(b"\x80\x04\x95\x0b\x00")
    for name in ("results.npy", "raw.npy"):
        with pytest.raises(FormatError, match=r"pickle.*never read.*numpy\.save.*\(samples, 22, 3, frames\)"):
            load(tmp_path / name)
    for name in ("a.pkl", "a.pt"):
        with pytest.raises(InputError, match=r"pickle.*never read"):
            load(tmp_path / name)


@pytest.mark.parametrize("shape", [(30, 23, 3), (30, 66), (30, 272), (22, 3), (2, 30, 22, 4), (3, 3, 3), ()])
def test_other_shapes_are_refused_with_those_that_are_read(shape, tmp_path):
    with pytest.raises(FormatError, match=r"\(frames, 22, 3\).*263"):
        load(written(tmp_path, np.ones(shape)))


SPELLINGS = {
    "AMASS": lambda a: {k: a[k] for k in ("poses", "trans", "mocap_framerate")},
    "three axes": lambda a: {"poses": a["poses"].reshape(-1, 52, 3), "trans": a["trans"], "mocap_frame_rate": [60.0]},
    "SMPL-X, Kimodo, GMR": lambda a: {k: a[k] for k in ("root_orient", "pose_body", "trans", "mocap_frame_rate")},
    "smplx": lambda a: {
        "global_orient": a["root_orient"],
        "body_pose": a["pose_body"].reshape(-1, 21, 3),
        "transl": a["trans"],
        "fps": a["mocap_frame_rate"],
    },
}


@pytest.mark.parametrize("spelling", SPELLINGS)
def test_smpl_poses_are_read_in_every_spelling(motion, spelling, tmp_path):
    save(motion.resampled(60.0), tmp_path / "a.amass.npz")
    with np.load(tmp_path / "a.amass.npz", allow_pickle=False) as plain:
        arrays = dict(plain)
    np.savez(tmp_path / "b.npz", **SPELLINGS[spelling](arrays))
    found = load(tmp_path / "b.npz")
    assert (found.fps, found.skeleton) == (60.0, HML22)
    assert (found.joints - load(tmp_path / "a.amass.npz").joints).abs().max() < 1e-5


def test_smpl_poses_with_y_up_stand_too(tmp_path):
    path = tmp_path / "a.npz"
    poses, trans = np.zeros((5, 63)), np.tile([0.0, 0.95, 0.0], (5, 1))
    np.savez(path, global_orient=np.zeros((5, 3)), body_pose=poses, transl=trans)
    with pytest.raises(FormatError, match="--source-fps"):
        load(path)
    found = load(path, source_fps=30.0)
    assert found.fps == 30.0
    assert (found.joints[:, HML22.index("head"), 1] > found.joints[:, 0, 1] + 0.4).all()


def test_amass_files_have_both_spellings(motion, tmp_path):
    """What GMR reads: ``root_orient``, ``pose_body``, ``trans``, ``betas``, ``gender``, ``mocap_frame_rate``."""
    save(motion, tmp_path / "a.amass.npz")
    with np.load(tmp_path / "a.amass.npz", allow_pickle=False) as plain:
        assert np.array_equal(plain["poses"][:, :66], np.hstack((plain["root_orient"], plain["pose_body"])))
        assert (plain["pose_body"].shape, plain["betas"].shape) == ((30, 63), (16,))
        assert float(plain["mocap_frame_rate"]) == float(plain["mocap_framerate"]) == 20.0
        assert torch.from_numpy(plain["trans"]).isfinite().all()
