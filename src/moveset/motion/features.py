"""What a feature codec is, how to get one by name, and how features are normalised. F frames, D features."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from itertools import accumulate
from typing import Protocol

import torch
from torch import Tensor

from moveset.errors import InputError
from moveset.motion.clip import Motion
from moveset.motion.skeleton import Skeleton

CODECS = ("hml", "kit", "native")

# T2M's channels that can be made louder during training by dividing their standard deviation (``feat_bias``).
BIASED_GROUPS = ("root_yaw", "root_velocity", "root_height", "contacts")


class FeatureCodec(Protocol):
    """Turns motions into rows of numbers that a network learns, and back.

    ``get_codec`` knows it by ``name``; a frame has ``dim`` features. The motions that it takes and gives are on
    ``skeleton``, at ``fps``.
    """

    name: str
    dim: int
    skeleton: Skeleton
    fps: float

    @property
    def groups(self) -> Mapping[str, slice]:
        """Columns by meaning, covering all D once, as ``Normalizer`` wants them.

        Named root_yaw, root_velocity, root_height, positions, rotations, velocities and contacts, in the codec's order.
        """

    def encode(self, motion: Motion) -> Tensor:
        """Features (F', D) of a motion of F frames; F' is F, or F - 1 where a frame needs its successor."""

    def decode(self, features: Tensor) -> Motion:
        """The motion of features (F, D)."""

    def joints(self, features: Tensor) -> Tensor:
        """Joint positions (..., F, J, 3) in metres of features (..., F, D), without building a motion."""

    def root_path(self, features: Tensor) -> tuple[Tensor, Tensor]:
        """Heading angle (..., F) in radians and root position (..., F, 3) in metres, as ``decode`` has them.

        Both are integrated from zero, so those of a clip with one row more say where it leads.
        """

    def with_steps(self, features: Tensor, change_S2: Tensor) -> Tensor:
        """Features (F, D) whose root goes further by (x, z) metres from each frame to the next, S = F - 1.

        So does the last frame, whose step leads out of the clip, by as much as the one before it.
        """

    def planted(self, features: Tensor) -> Tensor:
        """Which feet stand, (F, 4) bool: left ankle, left toe, right ankle, right toe."""


def grouped(**sizes: int) -> dict[str, slice]:
    """Columns of features by meaning, given how many each has, in this order.

    >>> grouped(root_yaw=1, root_velocity=2)
    {'root_yaw': slice(0, 1, None), 'root_velocity': slice(1, 3, None)}
    """
    ends = accumulate(sizes.values())
    return {name: slice(end - size, end) for (name, size), end in zip(sizes.items(), ends, strict=True)}


def integrated(steps: Tensor) -> Tensor:
    """Running sum of (..., F, C) over frames that starts at zero; the last step leads out of the clip and is not used.

    >>> integrated(torch.tensor([[1.0], [2.0], [4.0]])).flatten().tolist()
    [0.0, 1.0, 3.0]
    """
    return torch.cat((torch.zeros_like(steps[..., :1, :]), torch.cumsum(steps[..., :-1, :], dim=-2)), dim=-2)


@cache
def get_codec(name: str) -> FeatureCodec:
    """The codec of that name: "hml" (HumanML3D, 263), "kit" (KIT-ML, 251) or "native" (269, true rotations).

    Raises:
        InputError: another name.
    """
    if name in ("hml", "kit"):
        from moveset.motion.hml import HmlCodec
        from moveset.motion.hml_skeletons import HUMANML3D, KIT_ML

        return HmlCodec(HUMANML3D if name == "hml" else KIT_ML)
    if name == "native":
        from moveset.motion.native import NativeCodec

        return NativeCodec()
    raise InputError(f"unknown feature codec {name!r}; choose one of {', '.join(CODECS)}")


@dataclass(frozen=True, eq=False)
class Normalizer:
    """Affine normalisation of features: ``normalize`` subtracts the mean and divides by the standard deviation.

    Args:
        mean: (D,) float32.
        std: (D,) float32, all above 0.

    Raises:
        InputError: shapes that differ, or values that are not finite or not above 0.
    """

    mean: Tensor
    std: Tensor

    def __post_init__(self) -> None:
        if self.mean.ndim != 1 or self.mean.shape != self.std.shape:
            raise InputError(
                f"a normaliser needs a mean and a standard deviation (D,); got {tuple(self.mean.shape)} and "
                f"{tuple(self.std.shape)}"
            )
        if not (torch.isfinite(self.mean).all() and torch.isfinite(self.std).all() and (self.std > 0).all()):
            raise InputError(
                "a normaliser needs finite means and standard deviations above 0; recompute the statistics"
            )

    @classmethod
    def fit(cls, clips: Iterable[Tensor], groups: Mapping[str, slice]) -> "Normalizer":
        """Statistics of clips (F, D), each frame weighing the same, in one pass and float64.

        The standard deviation of each column is replaced by its group's mean, so that the parts of one quantity keep
        their proportions (HumanML3D's rule; population deviation). A group that never varies gets 1.

        Raises:
            InputError: no frames, or groups that do not cover the columns once each.
        """
        count, shift = 0, torch.zeros(0, dtype=torch.float64)
        total = square = shift
        for clip in clips:
            x = clip.detach().to(device="cpu", dtype=torch.float64)
            if count == 0:
                # Sums about one of the values: raw sums of squares cancel for columns far from 0 (a root height in mm).
                shift = x[0].clone()
                total, square = torch.zeros_like(shift), torch.zeros_like(shift)
            x = x - shift
            count, total, square = count + len(x), total + x.sum(0), square + (x * x).sum(0)
        if count == 0:
            raise InputError("statistics need at least one frame of features; the corpus given is empty")
        covered = [column for part in groups.values() for column in range(len(total))[part]]
        if sorted(covered) != list(range(len(total))):
            raise InputError(f"the feature groups {list(groups)} do not cover {len(total)} columns once each")
        mean = total / count
        std = (square / count - mean * mean).clamp_min(0.0).sqrt()
        for part in groups.values():
            shared = std[part].mean()
            std[part] = shared if shared > 1e-9 else 1.0
        return cls((mean + shift).float(), std.float())

    def biased(self, groups: Mapping[str, slice], feat_bias: float) -> "Normalizer":
        """With the standard deviations of root and contacts divided by ``feat_bias``: they weigh that much more.

        T2M means 5 but divides twice, so its published evaluators expect 25; latent diffusion models use 1.

        Raises:
            InputError: a bias not above 0.
        """
        if not feat_bias > 0:
            raise InputError(f"feat_bias {feat_bias} is not above 0; 1 leaves the statistics as they are")
        std = self.std.clone()
        for name in BIASED_GROUPS:
            std[groups[name]] /= feat_bias
        return Normalizer(self.mean, std)

    def normalize(self, features: Tensor) -> Tensor:
        """(..., D) to zero mean and unit (group) variance."""
        return (features - self.mean.to(features)) / self.std.to(features)

    def denormalize(self, normalized: Tensor) -> Tensor:
        """The inverse of ``normalize``."""
        return normalized * self.std.to(normalized) + self.mean.to(normalized)
