"""Units of length of files that do not say theirs, guessed from the size of the body."""

import math
from collections.abc import Sequence
from dataclasses import replace

from torch import Tensor

from moveset.errors import InputError
from moveset.motion.body_axes import leg_length
from moveset.motion.clip import Motion
from moveset.motion.rigs import roles
from moveset.motion.skeleton import Skeleton

_METRIC = (1.0, 0.01, 0.001)
# Inches, feet, decimetres, and the unit of CMU's ASF files (of which 0.45 are an inch), which conversions keep.
_OTHERS = (0.0254, 0.3048, 0.1, 0.0254 / 0.45)
_LEG, _REACH = 0.82, 2.0  # metres: hip to ankle; from hand to foot along the bones
# Parts of an adult's size: what people have, and what small and large characters have.
_PEOPLE, _CHARACTERS = (0.65, 1.45), (0.3, 2.0)
_SMALLEST = 1e-9
# Of files whose unit is given, as glTF's is: sizes that nobody means.
_ABSURD = (0.1, 4.0)


def _by_legs(skeleton: Skeleton) -> float:
    """Size of a body whose offsets are in any unit, as a part of an adult's; 0 where there are no known legs."""
    try:
        return leg_length(skeleton, roles(skeleton)) / _LEG
    except InputError:
        return 0.0


def likely_unit(skeleton: Skeleton) -> float:
    """Metres per unit: the metric unit that makes the body as large as people are, else another unit that does, else
    a metric one for a small or large character, else what makes it an adult."""
    size = max(_by_legs(skeleton) or bone_reach(skeleton.parents, skeleton.offsets) / _REACH, _SMALLEST)
    for units, (low, high) in ((_METRIC, _PEOPLE), (_OTHERS, _PEOPLE), (_METRIC, _CHARACTERS)):
        if fitting := [unit for unit in units if low <= size * unit <= high]:
            return min(fitting, key=lambda unit: abs(math.log(size * unit)))
    return 1.0 / size


def resized(motion: Motion, scale: float) -> Motion:
    """The motion with all its lengths times ``scale``."""
    body = replace(motion.skeleton, offsets=motion.skeleton.offsets * scale)
    return replace(motion, root=motion.root * scale, skeleton=body)


def unit_of(motion: Motion) -> float:
    """Metres per unit of a motion that is meant to be in metres: 1, but for human bodies of an absurd size."""
    low, high = _ABSURD
    size = _by_legs(motion.skeleton)
    return 1.0 if size == 0.0 or low <= size <= high else likely_unit(motion.skeleton)


def bone_reach(parents: Sequence[int], offsets: Tensor) -> float:
    """The longest way along the bones (J, 3) from one joint to another, not counting the bone of the root itself."""
    lengths = offsets.norm(dim=-1).tolist()
    below = [0.0] * len(parents)
    best = 0.0
    for j in range(len(parents) - 1, 0, -1):
        way = below[j] + lengths[j]
        # The way down this branch joined to the longest one seen in another branch of the same parent.
        best = max(best, way + below[parents[j]])
        below[parents[j]] = max(below[parents[j]], way)
    return best
