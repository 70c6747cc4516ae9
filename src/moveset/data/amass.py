"""AMASS: motion as SMPL pose parameters in .npz files (Mahmood et al. 2019, arXiv 1904.03278)."""

from pathlib import Path

import torch

from moveset.io.amass import amass_motion
from moveset.io.numpy_file import Npz
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.skeleton import HML22


def read_amass(path: str | Path, fps: float = 20.0) -> Motion:
    """A take on ``hml22``, starting above the origin, facing +Z, standing on the floor.

    The first 22 joints of SMPL, SMPL-H and SMPL-X are those of ``hml22``, whose rest pose is SMPL's T-pose up to a few
    degrees, so rotations are taken as they are. The shape parameters are not used: the body model is licensed
    separately, and everybody gets the limbs of ``hml22``. AMASS is Z up; the result is Y up.

    Args:
        path: a file in any spelling that ``io.amass`` reads.
        fps: frame rate of the result.

    Raises:
        InputError: the file is missing, or fps is out of range.
        FormatError: arrays are missing, do not belong together, are not finite or too long.
    """
    with Npz(path) as npz:
        motion = amass_motion(npz)
    motion = motion.resampled(fps).canonical()
    feet = motion.joints[:, list(HML22.feet), 1].min(dim=1).values
    floor = feet.quantile(0.01)
    return motion.transformed(rotations.identity(), torch.stack((floor * 0, -floor, floor * 0)))
