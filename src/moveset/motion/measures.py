"""Physical plausibility of joint positions: sliding feet, jitter, seams, drift, and how the body stands on the floor.

Shapes: ``...`` clips (any leading shape, none at all included), F frames, J joints. Positions are in metres with Y up
and the floor at y = 0. Every measure returns one float32 value a clip: whoever averages decides whether clips or frames
weigh the same. Clips with too few frames for a measure's differences are an ``InputError``.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from moveset.errors import InputError
from moveset.motion.contacts import TOE_HEIGHT
from moveset.motion.skeleton import HML22, Skeleton

_SLIDING = 0.5  # metres a second


def measure(joints: Tensor, fps: float, skeleton: Skeleton = HML22) -> dict[str, Tensor]:
    """All measures of joints (..., F, J, 3) that need nothing else, by the functions' names, one value a clip (...).

    Raises:
        InputError: a clip with fewer than four frames, or with positions that are not finite.
    """
    broken = ~torch.isfinite(joints).flatten(-3).all(dim=-1)
    if count := int(broken.sum()):
        raise InputError(f"{count} of {broken.numel()} clips have joint positions that are not finite; leave them out")
    return {
        "skating": skating(joints, fps, skeleton),
        "jerk": jerk(joints, fps),
        "acceleration": acceleration(joints, fps),
        "penetration": penetration(joints),
        "floating": floating(joints, skeleton),
        "root_drift": root_drift(joints, fps),
    }


def skating(joints: Tensor, fps: float, skeleton: Skeleton = HML22, *, window: int = 1) -> Tensor:
    """Share of frames in which a foot slides over the floor, in [0, 1].

    A toe slides between two frames when it is lower than 5 cm in both and its planar speed exceeds 0.5 m/s; a frame
    counts once, whichever foot slides. With ``window=5`` the speed averaged over five frames (zeros beyond the ends)
    must exceed the limit too: the skating ratio of GMD and OmniControl, used by MotionLCM.

    Raises:
        InputError: a clip with fewer than two frames, or an even window.
    """
    if window < 1 or window % 2 == 0:
        raise InputError(f"a moving average over {window} frames has no centre; give an odd number such as 1 or 5")
    _check(joints, 2)
    toes = joints[..., list(skeleton.feet[1::2]), :].float()
    moved = (toes[..., 1:, :, :] - toes[..., :-1, :, :])[..., [0, 2]].norm(dim=-1) * fps
    low = (toes[..., 1] < TOE_HEIGHT)[..., 1:, :] & (toes[..., 1] < TOE_HEIGHT)[..., :-1, :]
    slides = (low & (moved > _SLIDING) & (_moving_average(moved, window) > _SLIDING)).any(dim=-1)
    return slides.float().mean(dim=-1)


def jerk(joints: Tensor, fps: float) -> Tensor:
    """Mean size of the third time derivative over joints and frames, m/s³ (third differences times fps³).

    Raises:
        InputError: a clip with fewer than four frames.
    """
    return jerk_sizes(joints, fps).mean(dim=-1).float()


def acceleration(joints: Tensor, fps: float) -> Tensor:
    """Mean size of the second time derivative over joints and frames, m/s².

    Raises:
        InputError: a clip with fewer than three frames.
    """
    _check(joints, 3)
    # In float64 for the same reason as jerk.
    return (torch.diff(joints.double(), n=2, dim=-3).norm(dim=-1).mean(dim=(-1, -2)) * fps**2).float()


def penetration(joints: Tensor) -> Tensor:
    """How deep the lowest joint is under the floor, metres, mean over frames (0 where it is above)."""
    _check(joints, 1)
    return (-joints[..., 1].amin(dim=-1)).clamp_min(0.0).float().mean(dim=-1)


def floating(joints: Tensor, skeleton: Skeleton = HML22) -> Tensor:
    """How far the lowest foot joint is above 5 cm, metres, mean over frames; jumps and sitting count too.

    A toe joint lies a few centimetres above its sole, hence the tolerance.
    """
    _check(joints, 1)
    lowest = joints[..., list(skeleton.feet), 1].amin(dim=-1)
    return (lowest - TOE_HEIGHT).clamp_min(0.0).float().mean(dim=-1)


def root_drift(joints: Tensor, fps: float) -> Tensor:
    """How much higher or lower the root ends than it began, metres: a body that sinks or rises without being told to.

    Mean height of joint 0 over the clip's last second against its first (halves of a clip under two seconds), absolute.
    It needs no reference; real clips that end in a crouch have it too, so compare with real motion. ``windows`` follows
    a long stream over time.

    Raises:
        InputError: a clip with fewer than two frames.
    """
    _check(joints, 2)
    span = min(joints.shape[-3] // 2, max(round(fps), 1))
    height = joints[..., 0, 1].double()
    return (height[..., -span:].mean(dim=-1) - height[..., :span].mean(dim=-1)).abs().float()


def jerk_sizes(joints: Tensor, fps: float) -> Tensor:
    """Size of the third derivative at every four frames t … t + 3, m/s³, mean over joints: (..., F - 3) float64.

    Raises:
        InputError: a clip with fewer than four frames.
    """
    _check(joints, 4)
    # Differences of metres cancel three times: float32 would leave an error of several m/s³ far from the origin.
    return torch.diff(joints.double(), n=3, dim=-3).norm(dim=-1).mean(dim=-1) * fps**3


def near_seams(frames: int, seams: Sequence[int], reach: int) -> Tensor:
    """(frames - 3) marks of the four frames whose middle is within ``reach`` frames of a seam.

    Args:
        seams: first frames of segments; a seam lies half a frame before. With ``reach=1`` the three windows that span
            the seam are marked, with 2 also the ones that touch it. Numbers outside 1 … frames - 1 are no seams.
    """
    # The middle of t … t + 3 is t + 1.5, the seam s - 0.5.
    real_S = torch.tensor([seam for seam in seams if 0 < seam < frames], dtype=torch.long)
    return ((torch.arange(frames - 3)[:, None] + 2 - real_S).abs() <= reach).any(dim=1)


@dataclass(frozen=True)
class Boundary:
    """Jerk near seams and elsewhere, m/s³: one value a clip each."""

    near: Tensor
    elsewhere: Tensor


def boundary_jerk(joints: Tensor, fps: float, seams: Sequence[int], *, reach: int = 2) -> Boundary:
    """Jerk within ± ``reach`` frames of the seams of streams or timelines (``near_seams``), and everywhere else.

    Args:
        seams: first frames of segments, the same for all clips.

    Raises:
        InputError: a clip with fewer than four frames, without a seam, or with seams everywhere.
    """
    sizes = jerk_sizes(joints, fps)
    near = near_seams(joints.shape[-3], seams, reach).to(joints.device)
    if not near.any() or near.all():
        raise InputError(
            f"{joints.shape[-3]} frames have no seam, or no place away from one; give the first frame of each segment "
            "after the first"
        )
    return Boundary(sizes[..., near].mean(dim=-1).float(), sizes[..., ~near].mean(dim=-1).float())


@dataclass(frozen=True)
class Windows:
    """A stream cut into W windows of equal length: what may drift, (..., W) each.

    Args:
        height: mean height of the root, metres.
        speed: mean speed of all joints, m/s: it falls where motion freezes.
        jerk: m/s³: it rises where motion starts to tremble.
        skating: as ``skating``.
        seconds: length of a window.
    """

    height: Tensor
    speed: Tensor
    jerk: Tensor
    skating: Tensor
    seconds: float

    def drift(self, name: str) -> Tensor:
        """Change of one of them per minute (...), the slope of the least-squares line through the windows.

        Raises:
            InputError: fewer than two windows.
        """
        values = getattr(self, name).double()
        count = values.shape[-1]
        if count < 2:
            raise InputError(f"a drift needs at least 2 windows, and there is {count}; make the stream longer")
        minutes = torch.arange(count, dtype=torch.float64, device=values.device) * self.seconds / 60.0
        minutes = minutes - minutes.mean()
        slope: Tensor = (values * minutes).sum(dim=-1) / minutes.square().sum()
        return slope.float()


def windows(joints: Tensor, fps: float, seconds: float = 10.0, skeleton: Skeleton = HML22) -> Windows:
    """Whole windows of streams (..., F, J, 3), measured one by one; an unfinished last window does not count.

    Raises:
        InputError: a window of fewer than four frames, or a stream shorter than one window.
    """
    frames = round(seconds * fps)
    count = joints.shape[-3] // max(frames, 1)
    if frames < 4 or count < 1:
        raise InputError(
            f"a stream of {joints.shape[-3]} frames has no window of {frames} frames (4 or more); measure shorter ones"
        )
    cut = joints[..., : count * frames, :, :].unflatten(-3, (count, frames))
    steps = torch.diff(cut.double(), dim=-3).norm(dim=-1) * fps
    return Windows(
        height=cut[..., 0, 1].double().mean(dim=-1).float(),
        speed=steps.mean(dim=(-1, -2)).float(),
        jerk=jerk(cut, fps),
        skating=skating(cut, fps, skeleton=skeleton),
        seconds=frames / fps,
    )


def _check(joints: Tensor, least: int) -> None:
    if joints.shape[-3] < least:
        raise InputError(
            f"a clip of {joints.shape[-3]} frames is too short for a measure of {least}; leave shorter clips out"
        )


def _moving_average(values: Tensor, window: int) -> Tensor:
    """Centred mean over dimension -2, zeros beyond the ends."""
    frames, half = values.shape[-2], window // 2
    padded = torch.nn.functional.pad(values, (0, 0, half, half))
    return torch.stack([padded[..., k : k + frames, :] for k in range(window)]).mean(dim=0)
