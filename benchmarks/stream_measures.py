"""Measures of motion that is made in segments: laws of segments, seams, and whether later segments collapse.

B items, N segments, n frames of a segment, D features, F frames, J joints.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from moveset.evaluation.frechet import frechet_distance
from moveset.motion.measures import jerk_sizes, near_seams

FIRST, SECOND, LATER = "first", "second", "later"


@dataclass(frozen=True, eq=False)
class SegmentSpace:
    """Coordinates of whole segments: their principal components, so that a few hundred make a covariance.

    Distances are root mean squares over frames and features: 1 is a deviation of the normalised features.

    Args:
        mean: (n D,).
        axes: (n D, C).
    """

    mean: Tensor
    axes: Tensor

    @classmethod
    def fit(cls, segments_BnD: Tensor, components: int = 48) -> "SegmentSpace":
        """Of normalised segments; training takes, so that nothing that is judged has a say."""
        flat = segments_BnD.flatten(1).double()
        mean = flat.mean(0)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(0)
            _, _, axes = torch.svd_lowrank(flat - mean, q=components, niter=4)
        return cls(mean, axes / axes.shape[0] ** 0.5)

    def __call__(self, segments_BnD: Tensor) -> Tensor:
        """(B, C)."""
        return (segments_BnD.flatten(1).double() - self.mean) @ self.axes


def cut(sequences: Sequence[Tensor], n: int) -> dict[str, Tensor]:
    """Whole segments (B, n, D) of sequences (F, D), cut from the first frame: first ones, second ones, later ones."""
    parts: dict[str, list[Tensor]] = {FIRST: [], SECOND: [], LATER: []}
    for features in sequences:
        for i, piece in enumerate(features.split(n)):
            if len(piece) == n:
                parts[(FIRST, SECOND, LATER)[min(i, 2)]].append(piece)
    empty = sequences[0].new_zeros(0, n, sequences[0].shape[1])
    return {name: torch.stack(found) if found else empty for name, found in parts.items()}


def segment_laws(space: SegmentSpace, made: dict[str, Tensor], real: dict[str, Tensor]) -> dict[str, float]:
    """Fréchet distances of segments to real ones at the same places, and of frames whatever their order."""
    out = {}
    for name, pieces in made.items():
        if min(len(pieces), len(real[name])) >= 2:
            out[f"segment_frechet_{name}"] = frechet_distance(space(pieces), space(real[name]))
    frames, real_frames = made[LATER].flatten(0, 1), real[LATER].flatten(0, 1)
    if min(len(frames), len(real_frames)) >= 2:
        width = frames.shape[1] ** 0.5
        out["frame_frechet_later"] = frechet_distance(frames / width, real_frames / width)
        out["std_later"] = float(made[LATER].std(unbiased=False))
    return out


def seam_jerk(joints_FJ3: Tensor, n: int, fps: float) -> tuple[Tensor, Tensor]:
    """Sizes of the third derivative (m/s³, mean over joints) where four frames span a seam, and where they don't."""
    size = jerk_sizes(joints_FJ3, fps)
    spans = near_seams(len(joints_FJ3), torch.arange(n, max(len(joints_FJ3), n), n), reach=1)
    return size[spans], size[~spans]


def seams(joints: Sequence[Tensor], n: int, fps: float) -> dict[str, float]:
    """Jerk at seams and inside of segments, over all clips, and the 95th percentile of the hardest moment of a seam."""
    at, inside, worst = [], [], []
    for clip in joints:
        spanning, rest = seam_jerk(clip, n, fps)
        at.append(spanning)
        inside.append(rest)
        worst += [window.amax() for window in spanning.split(3) if len(window)]
    both = torch.cat(at), torch.cat(inside)
    if not len(both[0]):
        return {}
    return {
        "jerk_seam": float(both[0].mean()),
        "jerk_inside": float(both[1].mean()),
        "jerk_ratio": float(both[0].mean() / both[1].mean()),
        "jerk_seam_p95": float(torch.stack(worst).quantile(0.95)),
    }


def spread(space: SegmentSpace, segments_SNnD: Tensor) -> list[float]:
    """Mean distance between the samples of one prompt, by number of the segment: it falls where they collapse."""
    return [float(torch.pdist(space(segments_SNnD[:, i])).mean()) for i in range(segments_SNnD.shape[1])]


def change(space: SegmentSpace, segments_SNnD: Tensor) -> float:
    """Mean distance between a segment and the one before it: 0 for copies."""
    here = torch.stack([space(s) for s in segments_SNnD.unbind(1)], dim=1)
    return float((here[:, 1:] - here[:, :-1]).norm(dim=-1).mean())
