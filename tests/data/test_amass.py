"""AMASS files: the same motion comes back, upright, at the asked rate, on the floor."""

import numpy as np
import pytest
import torch

from moveset.data.amass import read_amass
from moveset.data.synthetic import synthetic_motion
from moveset.errors import FormatError, InputError
from moveset.motion import rotations
from moveset.motion.skeleton import HML22


def axis_angle(q: torch.Tensor) -> np.ndarray:
    """By logarithm, independent of the reader."""
    q = torch.where(q[..., 3:] < 0, -q, q).double()
    size = q[..., :3].norm(dim=-1, keepdim=True)
    return (q[..., :3] / size.clamp_min(1e-12) * 2 * torch.atan2(size, q[..., 3:])).numpy()


def amass_file(path, motion, rate=120.0, rate_name="mocap_framerate", columns=156):
    """A Z-up file of a motion, hands and all."""
    motion = motion.transformed(rotations.about("x", 90.0), torch.tensor([4.0, -2.0, 0.7]))
    poses = np.zeros((len(motion), columns))
    poses[:, :66] = axis_angle(motion.rotations).reshape(len(motion), 66)
    np.savez(
        path,
        poses=poses,
        trans=motion.root.numpy(),
        gender="neutral",
        betas=np.zeros(16),
        **{rate_name: np.array(rate)},
    )
    return path


@pytest.mark.parametrize("kind", ["walk-turn-left", "wave-right-hand", "bow"])
@pytest.mark.parametrize(("name", "columns"), [("mocap_framerate", 156), ("mocap_frame_rate", 165)])
def test_the_motion_comes_back(tmp_path, kind, name, columns):
    motion = synthetic_motion(kind, 301, seed=2, fps=120.0).canonical()
    read = read_amass(amass_file(tmp_path / "a.npz", motion, rate_name=name, columns=columns))
    assert read.fps == 20.0
    assert read.skeleton is HML22
    assert len(read) == 51
    assert (read.joints - motion.resampled(20.0).joints).norm(dim=-1).max() < 0.03
    feet = read.joints[:, list(HML22.feet), 1].min(dim=1).values
    assert abs(float(feet.quantile(0.01))) < 1e-4


def test_the_rate_can_be_chosen(tmp_path):
    motion = synthetic_motion("walk", 121, fps=120.0)
    assert len(read_amass(amass_file(tmp_path / "a.npz", motion), fps=30.0)) == 31


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"poses": np.zeros((5, 60))}, "poses"),
        ({"trans": np.zeros((4, 3))}, "trans"),
        ({"poses": np.full((5, 66), np.nan)}, "not finite"),
        ({"mocap_framerate": np.array(0.0)}, "frames per second"),
        ({"mocap_framerate": np.array([30.0, 60.0])}, "frames per second"),
        ({"poses": np.zeros((0, 66)), "trans": np.zeros((0, 3))}, "poses"),
    ],
)
def test_what_is_wrong_is_said(tmp_path, change, words):
    arrays = {"poses": np.zeros((5, 66)), "trans": np.zeros((5, 3)), "mocap_framerate": np.array(60.0)} | change
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(FormatError, match=words):
        read_amass(tmp_path / "a.npz")


def test_a_shape_file_is_no_motion(tmp_path):
    np.savez(tmp_path / "shape.npz", betas=np.zeros(16))
    with pytest.raises(FormatError, match="poses"):
        read_amass(tmp_path / "shape.npz")
    with pytest.raises(InputError, match="No such file"):
        read_amass(tmp_path / "nothing.npz")
