"""Smoothing over time: Gaussian, and offsets that die away (inertialisation; Bollo, "Inertialization", GDC 2018).

T frames, C channels.
"""

import torch
from torch import Tensor


def gaussian_smooth(x: Tensor, sigma: float) -> Tensor:
    """Gaussian smoothing of (T, C) over time; the end values continue beyond the ends.

    The same weights and borders as ``scipy.ndimage.gaussian_filter1d`` with mode "nearest".

    Args:
        sigma: standard deviation in frames, of which the filter reaches four.
    """
    radius = int(4.0 * sigma + 0.5)
    at = torch.arange(-radius, radius + 1, dtype=x.dtype, device=x.device)
    weights = torch.exp(-0.5 / sigma**2 * at**2)
    index = torch.arange(-radius, len(x) + radius, device=x.device).clamp(0, len(x) - 1)
    kernel = (weights / weights.sum())[None, None]
    return torch.nn.functional.conv1d(x[index].mT[:, None], kernel)[:, 0].mT


def smoothstep(x: Tensor) -> Tensor:
    """From 0 at 0 to 1 at 1, with flat ends: 3 x² - 2 x³."""
    return x * x * (3.0 - 2.0 * x)


def spans(marks: Tensor) -> list[tuple[int, int]]:
    """First and one-past-last frame of every run of set frames of (F,) bool."""
    nothing = marks.new_zeros(1).int()
    edges = torch.diff(marks.int(), prepend=nothing, append=nothing).nonzero()[:, 0].tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))


def decay(offset: Tensor, velocity: Tensor, duration: float, at: Tensor) -> Tensor:
    """An offset that starts with a velocity and without acceleration and ends at rest, at zero, after ``duration``.

    Args:
        offset: (...) its value at time 0.
        velocity: (...) its rate of change there.
        duration: above 0, in the unit of ``at``.
        at: (N,) times from 0; zero offset after ``duration``.

    Returns:
        (N, ...) values of the quintic.
    """
    s = (at / duration).clamp(0.0, 1.0).reshape(-1, *(1,) * offset.ndim)
    value = 1.0 - s**3 * (10.0 - s * (15.0 - 6.0 * s))
    slope = s - s**3 * (6.0 - s * (8.0 - 3.0 * s))
    return value * offset + slope * duration * velocity


def settle(x: Tensor, fixed: Tensor, blend: int) -> Tensor:
    """Fill an offset track (F, C): given in the frames ``fixed`` (F,) bool, elsewhere dying away from them.

    From each run of fixed frames the offset continues with its velocity and reaches zero within ``blend`` frames, or
    earlier where the next run begins. Runs keep their values.
    """
    out = torch.where(fixed[:, None], x, 0.0)
    runs = spans(fixed)
    for k, (first, end) in enumerate(runs):
        last = end - 1
        inside = last > first
        before = runs[k - 1][1] - 1 if k > 0 else -blend
        after = runs[k + 1][0] if k + 1 < len(runs) else len(x) + blend
        for edge, step, room in ((last, 1, after - last), (first, -1, first - before)):
            duration = min(blend, room)
            frames = [edge + step * n for n in range(1, duration) if 0 <= edge + step * n < len(x)]
            if not frames:
                continue
            velocity = x[edge] - x[edge - step] if inside else torch.zeros_like(x[edge])
            times = torch.arange(1, len(frames) + 1, dtype=x.dtype)
            out[frames] += decay(x[edge], velocity, float(duration), times)
    return out
