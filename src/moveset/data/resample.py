"""Local rotations, root paths and positions at another rate, by cubic splines.

Where rates are no multiples, new frames fall between old ones; linear interpolation would ripple there, which halves
every other acceleration.
"""

import torch
from torch import Tensor

from moveset.errors import InputError
from moveset.motion import rotations


def resampled(local: Tensor, root: Tensor, times: Tensor, at: Tensor) -> tuple[Tensor, Tensor]:
    """Frames at other times.

    Args:
        local: (F, J, 4) rotations whose signs are continuous in time.
        root: (F, 3).
        times: (F,) seconds, rising; at least 2.
        at: (G,) seconds within them.

    Returns:
        (G, J, 4) and (G, 3), float64.

    Raises:
        InputError: scipy is not installed.
    """
    joints = local.shape[1]
    values = splined(torch.cat((local.double().reshape(len(local), -1), root.double()), dim=1), times, at)
    return rotations.normalize(values[:, :-3].reshape(-1, joints, 4)), values[:, -3:]


def splined(values: Tensor, times: Tensor, at: Tensor) -> Tensor:
    """Values (F, …) of rising ``times`` (F,) at others (G,): (G, …), float64.

    Raises:
        InputError: scipy is not installed.
    """
    try:
        from scipy.interpolate import CubicSpline
    except ImportError:
        raise InputError("takes of other rates need scipy; install it with pip install 'moveset[train]'") from None

    return torch.from_numpy(CubicSpline(times.numpy(), values.double().numpy())(at.numpy()))
