"""What HumanML3D and KIT-ML fix about a body: chains, canonical directions, bone lengths, thresholds."""

from dataclasses import dataclass

import torch
from torch import Tensor

from moveset.motion.skeleton import HML22, KIT21, Skeleton


@dataclass(frozen=True, eq=False)
class HmlConvention:
    """One dataset's constants.

    Args:
        name: the codec's name.
        skeleton: the skeleton of motions on the other side of the codec.
        chains: kinematic chains, each started with the root's rotation (even those that leave from the chest).
        directions: (J, 3) canonical unit direction of the bone that ends in each joint.
        lengths: (J,) bone lengths of the body that every clip is re-posed onto, metres.
        face: hip, hip, shoulder, shoulder; the initial heading takes the first minus the second and the third minus the
            fourth, the per-frame heading exchanges the hips.
        legs: the two joints whose bone lengths scale the root path.
        feet: joints of the four contacts, in their order.
        contact: a foot joint is planted while its squared step to the next frame is below this, units².
        unit: metres per unit of length of the features.
        reflected: whether the dataset's left and right are exchanged in space against its joint names.
    """

    name: str
    skeleton: Skeleton
    fps: float
    chains: tuple[tuple[int, ...], ...]
    directions: Tensor
    lengths: Tensor
    face: tuple[int, int, int, int]
    legs: tuple[int, int]
    feet: tuple[int, int, int, int]
    contact: float
    unit: float
    reflected: bool


_CARDINAL = {
    "0": (0.0, 0.0, 0.0), "x": (1.0, 0.0, 0.0), "X": (-1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "Y": (0.0, -1.0, 0.0),
    "z": (0.0, 0.0, 1.0),
}  # fmt: skip


def _directions(letters: str) -> Tensor:
    """One direction a letter: x y z, capitals for the negative, 0 for the root."""
    return torch.tensor([_CARDINAL[letter] for letter in letters], dtype=torch.float64)


HUMANML3D = HmlConvention(
    name="hml",
    skeleton=HML22,
    fps=20.0,
    chains=((0, 2, 5, 8, 11), (0, 1, 4, 7, 10), (0, 3, 6, 9, 12, 15), (9, 14, 17, 19, 21), (9, 13, 16, 18, 20)),
    directions=_directions("0xXyYYyYYyzzyxXzYYYYYY"),
    # The first frame of clip 000021, as published clips carry it; left and right differ.
    lengths=torch.tensor(
        (
            0.0, 0.10307, 0.10988, 0.13157, 0.39362, 0.39019, 0.14319, 0.43243, 0.42564, 0.05736, 0.14338, 0.14942,
            0.21936, 0.13749, 0.14338, 0.10304, 0.13161, 0.12298, 0.25684, 0.26309, 0.26601, 0.26988,
        ),
        dtype=torch.float64,
    ),
    face=(2, 1, 17, 16),
    legs=(5, 8),
    feet=(7, 10, 8, 11),
    contact=0.002,
    unit=1.0,
    reflected=False,
)  # fmt: skip

KIT_ML = HmlConvention(
    name="kit",
    skeleton=KIT21,
    fps=12.5,
    chains=((0, 11, 12, 13, 14, 15), (0, 16, 17, 18, 19, 20), (0, 1, 2, 3, 4), (3, 5, 6, 7), (3, 8, 9, 10)),
    directions=_directions("0yyyyxYYXYYxYYzzXYYzz"),
    # A stand-in with KIT-ML's proportions: its own reference clip (03950) is not public. ``HmlCodec`` takes others.
    lengths=KIT21.offsets.double().norm(dim=-1),
    face=(11, 16, 5, 8),
    legs=(17, 18),
    feet=(19, 20, 14, 15),
    contact=0.05,
    unit=0.001,
    # The published mean pose faces +Z, walks to +Z and has the joints named left at -X.
    reflected=True,
)
