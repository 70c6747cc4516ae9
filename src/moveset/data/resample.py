"""Local rotations and root paths at another rate, by cubic splines.

Where rates are no multiples, new frames fall between old ones; linear interpolation would ripple there, which halves
every other acceleration.
"""

import numpy as np
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
    try:
        from scipy.interpolate import CubicSpline
    except ImportError:
        raise InputError("takes of other rates need scipy; install it with pip install 'moveset[train]'") from None

    joints = local.shape[1]
    channels = np.concatenate((local.double().numpy().reshape(len(local), -1), root.double().numpy()), axis=1)
    values = torch.from_numpy(CubicSpline(times.numpy(), channels)(at.numpy()))
    return rotations.normalize(values[:, :-3].reshape(-1, joints, 4)), values[:, -3:]
