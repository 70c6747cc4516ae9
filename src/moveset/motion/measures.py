"""Physical plausibility of joint positions: sliding feet, jitter, seams, drift, and how the body stands on the floor.

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
    """Measures of whole clips, one value a clip (tensors of the clips' leading shape); units as in the functions."""

    skating: Tensor
    jerk: Tensor
    acceleration: Tensor
    penetration: Tensor
    floating: Tensor
    root_drift: Tensor

    def mean(self) -> dict[str, float]:
        """The mean over clips, by name."""
        return {name: float(getattr(self, name).mean()) for name in self.__dataclass_fields__}


def measure(joints: Tensor, fps: float, lengths: Tensor | None = None, skeleton: Skeleton = HML22) -> Physical:
    """All measures of joints (..., F, J, 3) that need nothing else, with their default thresholds.

    Raises:
        InputError: a clip with fewer than four frames, or with positions that are not finite.
    """
    broken = (~torch.isfinite(joints).flatten(-2).all(dim=-1) & _valid(joints, lengths, 0)).any(dim=-1)
    if count := int(broken.sum()):
        raise InputError(f"{count} of {broken.numel()} clips have joint positions that are not finite; leave them out")
    return Physical(
        skating=skating(joints, fps, lengths, skeleton),
        jerk=jerk(joints, fps, lengths),
        acceleration=acceleration(joints, fps, lengths),
        penetration=penetration(joints, lengths),
        floating=floating(joints, lengths, skeleton),
        root_drift=root_drift(joints, fps, lengths),
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
    return _mean(jerk_sizes(joints, fps), _valid(joints, lengths, 3)).float()


def acceleration(joints: Tensor, fps: float, lengths: Tensor | None = None) -> Tensor:
    """Mean size of the second time derivative over joints and frames, m/s².

    Raises:
        InputError: a clip with fewer than three frames.
    """
    valid = _valid(joints, lengths, 2)
    # In float64 for the same reason as jerk.
    size = torch.diff(joints.double(), n=2, dim=-3).norm(dim=-1).mean(dim=-1) * fps**2
    return _mean(size, valid).float()


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


def root_drift(joints: Tensor, fps: float, lengths: Tensor | None = None, *, seconds: float = 1.0) -> Tensor:
    """How much higher or lower the root ends than it began, metres: a body that sinks or rises without being told to.

    Mean height of joint 0 over the clip's last second against its first (halves of a clip under two seconds), absolute.
    It needs no reference; real clips that end in a crouch have it too, so compare with real motion. ``windows`` follows
    a long stream over time.

    Raises:
        InputError: a clip with fewer than two frames.
    """
    count = _valid(joints, lengths, 1).sum(dim=-1) + 1
    valid = _valid(joints, lengths, 0)
    span = torch.minimum(count // 2, torch.full_like(count, max(round(seconds * fps), 1)))[..., None]
    frame = torch.arange(joints.shape[-3], device=joints.device)
    last = valid & (frame >= count[..., None] - span)
    height = joints[..., 0, 1].double()
    return (_mean(height, last) - _mean(height, valid & (frame < span))).abs().float()


def path_deviation(joints: Tensor, reference: Tensor, lengths: Tensor | None = None) -> Tensor:
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


def jerk_sizes(joints: Tensor, fps: float) -> Tensor:
    """Size of the third derivative at every four frames t … t + 3, m/s³, mean over joints: (..., F - 3) float64."""
    # Differences of metres cancel three times: float32 would leave an error of several m/s³ far from the origin.
    return torch.diff(joints.double(), n=3, dim=-3).norm(dim=-1).mean(dim=-1) * fps**3


def near_seams(frames: int, seams: Tensor, reach: int) -> Tensor:
    """(..., frames - 3) marks of the four frames whose middle is within ``reach`` frames of a seam.

    Args:
        seams: (..., S) first frames of segments; a seam lies half a frame before. With ``reach=1`` the three windows
            that span the seam are marked, with 2 also the ones that touch it. Numbers outside 1 … frames - 1 are no
            seams, so that rows may be padded with 0.
    """
    around = torch.arange(-reach, reach + 1, device=seams.device)
    # The middle of t … t + 3 is t + 1.5, the seam s - 0.5. What is no place or no seam goes to one more column.
    place = (seams[..., None] - 2 + around).flatten(-2)
    real = ((seams > 0) & (seams < frames))[..., None].expand(*seams.shape, len(around)).flatten(-2)
    place = torch.where(real & (place >= 0) & (place < frames - 3), place, frames - 3)
    marks = torch.zeros(*seams.shape[:-1], frames - 2, dtype=torch.bool, device=seams.device)
    return marks.scatter(-1, place, True)[..., :-1]


@dataclass(frozen=True)
class Boundary:
    """Jerk near seams and elsewhere, m/s³: one value a clip each."""

    near: Tensor
    elsewhere: Tensor

    @property
    def ratio(self) -> float:
        """Mean near seams over mean elsewhere, all clips: 1 where seams are like any place.

        A quotient of means, not a mean of quotients, which one still clip would decide. Bodies that never move have 1.
        """
        near, elsewhere = float(self.near.double().mean()), float(self.elsewhere.double().mean())
        if elsewhere == 0.0:
            return 1.0 if near == 0.0 else float("inf")
        return near / elsewhere


def boundary_jerk(
    joints: Tensor, fps: float, seams: Tensor | Sequence[int], lengths: Tensor | None = None, *, reach: int = 2
) -> Boundary:
    """Jerk within ± ``reach`` frames of the seams of a stream or timeline, and everywhere else.

    Args:
        seams: first frames of segments, the same for all clips, or (..., S) for each clip (see ``near_seams``). Seams
            beyond a clip's length do not count.

    Raises:
        InputError: a clip with fewer than four frames, without a seam, or with seams everywhere.
    """
    valid = _valid(joints, lengths, 3)
    seams = torch.as_tensor(seams, device=joints.device)
    if not seams.numel():
        raise InputError("there are no seams to measure at; give the first frame of each segment after the first")
    count = valid.sum(dim=-1, keepdim=True) + 3
    near = near_seams(joints.shape[-3], torch.where(seams < count, seams, 0), reach) & valid
    rest = valid & ~near
    if not (near.any(dim=-1) & rest.any(dim=-1)).all():
        raise InputError(
            f"{int((~(near.any(-1) & rest.any(-1))).sum())} clips have no seam, or no place away from one; leave them "
            "out"
        )
    sizes = jerk_sizes(joints, fps)
    return Boundary(_mean(sizes, near).float(), _mean(sizes, rest).float())


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
