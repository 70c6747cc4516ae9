"""Physical plausibility of joint positions: sliding feet, jitter, and how the body stands on the floor.

Shapes: ``...`` clips (any leading shape, none at all included), F frames, J joints. Positions are in metres with Y up
and the floor at y = 0. ``lengths`` (...) counts each clip's real frames where shorter clips are padded; padding never
counts. Every measure returns one float32 value a clip: whoever averages decides whether clips or frames weigh the same.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from moveset.errors import InputError
from moveset.motion.skeleton import HML22, Skeleton


@dataclass(frozen=True)
class Physical:
    """All measures, one value a clip (tensors of the clips' leading shape); units as in the functions."""

    skating: Tensor
    jerk: Tensor
    acceleration: Tensor
    penetration: Tensor
    floating: Tensor

    def mean(self) -> dict[str, float]:
        """The mean over clips, by name."""
        return {name: float(getattr(self, name).mean()) for name in self.__dataclass_fields__}


def measure(joints: Tensor, fps: float, lengths: Tensor | None = None, skeleton: Skeleton = HML22) -> Physical:
    """Skating, jerk, acceleration, penetration and floating of joints (..., F, J, 3), with their default thresholds.

    Raises:
        InputError: a clip with fewer than four frames.
    """
    return Physical(
        skating=skating(joints, fps, lengths, skeleton),
        jerk=jerk(joints, fps, lengths),
        acceleration=acceleration(joints, fps, lengths),
        penetration=penetration(joints, lengths),
        floating=floating(joints, lengths, skeleton),
    )


def skating(
    joints: Tensor,
    fps: float,
    lengths: Tensor | None = None,
    skeleton: Skeleton = HML22,
    *,
    height: float = 0.05,
    speed: float = 0.5,
    window: int = 1,
) -> Tensor:
    """Share of frames in which a foot slides over the floor, in [0, 1].

    A toe slides between two frames when it is lower than ``height`` (m) in both and its planar speed exceeds ``speed``
    (m/s); a frame counts once, whichever foot slides. With ``window=5`` the speed averaged over five frames (zeros
    beyond the ends) must exceed the limit too: the skating ratio of GMD and OmniControl, used by MotionLCM.

    Raises:
        InputError: a clip with fewer than two frames, or an even window.
    """
    if window < 1 or window % 2 == 0:
        raise InputError(f"a moving average over {window} frames has no centre; give an odd number such as 1 or 5")
    valid = _valid(joints, lengths, 1)
    toes = joints[..., _toes(skeleton), :].float()
    moved = (toes[..., 1:, :, :] - toes[..., :-1, :, :])[..., [0, 2]].norm(dim=-1) * fps
    low = (toes[..., 1] < height)[..., 1:, :] & (toes[..., 1] < height)[..., :-1, :]
    # Padding must not leak into a clip's last moving averages.
    average = _moving_average(torch.where(valid[..., None], moved, 0.0), window)
    slides = (low & (moved > speed) & (average > speed)).any(dim=-1)
    return _mean(slides.float(), valid)


def jerk(joints: Tensor, fps: float, lengths: Tensor | None = None) -> Tensor:
    """Mean size of the third time derivative over joints and frames, m/s³ (third differences times fps³).

    Raises:
        InputError: a clip with fewer than four frames.
    """
    return _derivative(joints, fps, lengths, 3)


def acceleration(joints: Tensor, fps: float, lengths: Tensor | None = None) -> Tensor:
    """Mean size of the second time derivative over joints and frames, m/s².

    Raises:
        InputError: a clip with fewer than three frames.
    """
    return _derivative(joints, fps, lengths, 2)


def penetration(joints: Tensor, lengths: Tensor | None = None) -> Tensor:
    """How deep the lowest joint is under the floor, metres, mean over frames (0 where it is above)."""
    valid = _valid(joints, lengths, 0)
    return _mean((-joints[..., 1].amin(dim=-1)).clamp_min(0.0).float(), valid)


def floating(
    joints: Tensor, lengths: Tensor | None = None, skeleton: Skeleton = HML22, *, tolerance: float = 0.05
) -> Tensor:
    """How far the lowest foot joint is above ``tolerance`` (m), metres, mean over frames; jumps and sitting count too.

    A toe joint lies a few centimetres above its sole, hence the tolerance.
    """
    valid = _valid(joints, lengths, 0)
    lowest = joints[..., list(skeleton.feet), 1].amin(dim=-1)
    return _mean((lowest - tolerance).clamp_min(0.0).float(), valid)


def root_drift(joints: Tensor, reference: Tensor, lengths: Tensor | None = None) -> Tensor:
    """Planar distance of the root from a reference's at each clip's last frame, metres, both started at one place.

    Args:
        joints: (..., F, J, 3), or the root path as (..., F, 1, 3).
        reference: the same shape, e.g. the clip that a reconstruction should follow, or one frame of it (a standing
            body) broadcast over the frames.
    """
    last = _valid(joints, lengths, 0).sum(dim=-1) - 1
    offset = (joints - reference)[..., 0, :][..., [0, 2]].float()
    apart: Tensor = (offset - offset[..., :1, :]).norm(dim=-1)
    return apart.gather(-1, last[..., None])[..., 0]


def _derivative(joints: Tensor, fps: float, lengths: Tensor | None, order: int) -> Tensor:
    valid = _valid(joints, lengths, order)
    # Differences of metres cancel three times: float32 would leave an error of several m/s³ far from the origin.
    size = torch.diff(joints.double(), n=order, dim=-3).norm(dim=-1).mean(dim=-1) * fps**order
    return _mean(size, valid).float()


def _valid(joints: Tensor, lengths: Tensor | None, order: int) -> Tensor:
    """(..., F - order) marks: differences of that order which use no padding."""
    clips, frames = joints.shape[:-3], joints.shape[-3]
    if lengths is None:
        lengths = torch.full(clips, frames, device=joints.device)
    if lengths.shape != clips:
        raise InputError(
            f"lengths of shape {tuple(lengths.shape)} do not fit clips of shape {tuple(clips)}; give one each"
        )
    if lengths.numel() and not order < int(lengths.min()) <= int(lengths.max()) <= frames:
        raise InputError(
            f"clips of {int(lengths.min())} to {int(lengths.max())} frames in {frames}: this measure needs {order + 1} "
            f"to {frames} frames; leave shorter clips out"
        )
    valid: Tensor = torch.arange(frames - order, device=joints.device) < (lengths[..., None] - order)
    return valid


def _mean(values: Tensor, valid: Tensor) -> Tensor:
    return torch.where(valid, values, 0.0).sum(dim=-1) / valid.sum(dim=-1)


def _moving_average(values: Tensor, window: int) -> Tensor:
    """Centred mean over dimension -2, zeros beyond the ends."""
    frames, half = values.shape[-2], window // 2
    padded = torch.nn.functional.pad(values, (0, 0, half, half))
    return torch.stack([padded[..., k : k + frames, :] for k in range(window)]).mean(dim=0)


def _toes(skeleton: Skeleton) -> Sequence[int]:
    _, left, _, right = skeleton.feet
    return [left, right]
