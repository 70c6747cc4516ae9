"""Gaussian smoothing over time. T frames, C channels."""

import torch
from torch import Tensor


def gaussian_smooth(x: Tensor, sigma: float, truncate: float = 4.0) -> Tensor:
    """Gaussian smoothing of (T, C) over time; the end values continue beyond the ends.

    The same weights and borders as ``scipy.ndimage.gaussian_filter1d`` with mode "nearest".

    Args:
        x: values, floating point.
        sigma: standard deviation in frames.
        truncate: reach of the filter in standard deviations.
    """
    radius = int(truncate * sigma + 0.5)
    at = torch.arange(-radius, radius + 1, dtype=x.dtype, device=x.device)
    weights = torch.exp(-0.5 / sigma**2 * at**2)
    index = torch.arange(-radius, len(x) + radius, device=x.device).clamp(0, len(x) - 1)
    kernel = (weights / weights.sum())[None, None]
    return torch.nn.functional.conv1d(x[index].mT[:, None], kernel)[:, 0].mT
