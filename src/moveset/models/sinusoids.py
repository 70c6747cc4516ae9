"""Fixed positions as sinusoids, in the order of Vaswani et al. 2017 (arXiv 1706.03762), section 3.5."""

import torch
from torch import Tensor

from moveset.models.layers import time_embedding


def sinusoids(places: Tensor, width: int) -> Tensor:
    """(…,) numbers -> (…, width): [sin, cos, sin, cos, …] at frequencies 10000^(-2i / width); width is even.

    >>> sinusoids(torch.tensor([0, 1]), 2)
    tensor([[0.0000, 1.0000],
            [0.8415, 0.5403]])
    """
    cos_sin = time_embedding(places.flatten(), width).unflatten(-1, (2, -1))
    return torch.stack((cos_sin[:, 1], cos_sin[:, 0]), dim=-1).reshape(*places.shape, width)
