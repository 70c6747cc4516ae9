"""Is one method better than another on the same items? The paired difference and its bootstrap interval."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from moveset.errors import InputError


@dataclass(frozen=True)
class Difference:
    """Mean of a - b, and the interval in which 95 % of the resampled means lie."""

    mean: float
    low: float
    high: float

    @property
    def clear(self) -> bool:
        """Whether the interval leaves out zero."""
        return self.low > 0 or self.high < 0


def paired_difference(
    a: Sequence[float] | Tensor,
    b: Sequence[float] | Tensor,
    groups: Sequence[Hashable],
    draws: int = 10_000,
    seed: int = 0,
) -> Difference:
    """Mean of a - b over items that both methods were given, with a 95 % interval.

    Items of a group (clips of one take: same sentence frames, same content) are not independent, so groups are drawn
    anew, not items (cluster bootstrap: Davison & Hinkley 1997, Section 3.8).

    Raises:
        InputError: fewer than two groups, or lengths that differ.

    >>> paired_difference([1.0, 1.0, 1.0], [0.0, 0.0, 0.0], ["p", "q", "r"])
    Difference(mean=1.0, low=1.0, high=1.0)
    """
    one, other = (torch.as_tensor(x, dtype=torch.float64) for x in (a, b))
    names = list(dict.fromkeys(groups))
    if one.shape != other.shape or one.shape != (len(groups),) or len(names) < 2:
        raise InputError(
            f"a paired difference needs as many results of both methods as group names, and at least 2 groups; got "
            f"{len(one)}, {len(other)} and {len(groups)} in {len(names)} groups"
        )
    number = {name: k for k, name in enumerate(names)}
    group = torch.tensor([number[name] for name in groups])
    total = torch.zeros(len(names), dtype=torch.float64).index_add(0, group, one - other)
    count = torch.bincount(group, minlength=len(names)).double()
    chosen = torch.randint(len(names), (draws, len(names)), generator=torch.Generator().manual_seed(seed))
    means = total[chosen].sum(1) / count[chosen].sum(1)
    low, high = torch.quantile(means, torch.tensor([0.025, 0.975], dtype=torch.float64)).tolist()
    return Difference(float(total.sum() / count.sum()), low, high)
