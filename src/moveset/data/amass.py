"""AMASS: motion as SMPL pose parameters in .npz files (Mahmood et al. 2019, arXiv 1904.03278)."""

from pathlib import Path

import torch
from torch import Tensor

from moveset.errors import FormatError
from moveset.io.arrays import read_arrays
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.skeleton import HML22

MAX_FRAMES = 100_000
_JOINTS = 22


def read_amass(path: str | Path, fps: float = 20.0) -> Motion:
    """A take on ``hml22``, starting above the origin, facing +Z, standing on the floor.

    The first 22 joints of SMPL, SMPL-H and SMPL-X are those of ``hml22``, whose rest pose is SMPL's T-pose up to a few
    degrees, so rotations are taken as they are. The shape parameters are not used: the body model is licensed
    separately, and everybody gets the limbs of ``hml22``. AMASS is Z up; the result is Y up.

    Args:
        path: a file with ``poses`` (F, 66 or more) axis-angle in radians, ``trans`` (F, 3) in metres and
            ``mocap_framerate`` (or ``mocap_frame_rate``).
        fps: frame rate of the result.

    Raises:
        InputError: the file is missing, or fps is out of range.
        FormatError: arrays are missing, do not belong together, are not finite or too long.
    """
    found = read_arrays(path, ("poses", "trans", "mocap_framerate", "mocap_frame_rate"))
    rate = found.get("mocap_framerate", found.get("mocap_frame_rate"))
    missing = [n for n in ("poses", "trans") if n not in found] + ["mocap_framerate"] * (rate is None)
    if missing or rate is None:
        raise FormatError(f"{path} has no array {missing[0]!r}; it is not an AMASS motion (a shape file, perhaps)")
    poses, trans = found["poses"], found["trans"]
    frames = len(poses) if poses.ndim == 2 else 0
    if not 1 <= frames <= MAX_FRAMES or poses.shape[1] < 3 * _JOINTS or tuple(trans.shape) != (frames, 3):
        raise FormatError(
            f"{path} has poses {tuple(poses.shape)} and trans {tuple(trans.shape)}; expected (F, {3 * _JOINTS} or "
            f"more) and (F, 3) with 1 to {MAX_FRAMES} frames"
        )
    if rate.numel() != 1 or not 1.0 <= rate.item() <= 1000.0:
        raise FormatError(f"{path} says {rate.tolist()} frames per second; expected one number from 1 to 1000")
    if not (torch.isfinite(poses).all() and torch.isfinite(trans).all()):
        raise FormatError(f"{path} holds numbers that are not finite; remove or repair the file")
    local = _from_axis_angle(poses[:, : 3 * _JOINTS].reshape(frames, _JOINTS, 3))
    local = rotations.normalize(local).float()
    upright = rotations.about("x", -90.0)
    motion = Motion(local, trans, float(rate)).transformed(upright, torch.zeros(3)).resampled(fps).canonical()
    feet = motion.joints[:, list(HML22.feet), 1].min(dim=1).values
    floor = feet.quantile(0.01)
    return motion.transformed(rotations.identity(), torch.stack((floor * 0, -floor, floor * 0)))


def _from_axis_angle(vectors: Tensor) -> Tensor:
    angle = vectors.norm(dim=-1)
    return rotations.from_axis_angle(vectors / angle.clamp_min(1e-8)[..., None], angle)
