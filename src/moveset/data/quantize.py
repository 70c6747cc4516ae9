"""Quaternions in three 16-bit numbers: the smallest three components, 15 bits each, and where the largest one was."""

import torch
from torch import Tensor

from moveset.motion import rotations

_STEPS = 32767
# Every component but the largest of a unit quaternion lies in [-1/sqrt(2), 1/sqrt(2)].
_SCALE = 2.0**0.5
_OTHERS = ((1, 2, 3), (0, 2, 3), (0, 1, 3), (0, 1, 2))


def pack(q: Tensor) -> Tensor:
    """Unit quaternions (..., 4) as int16 (..., 3); wrong by less than 1.5e-4 rad, the sign is lost."""
    largest = q.abs().argmax(dim=-1, keepdim=True)
    q = torch.where(q.gather(-1, largest) < 0, -q, q)
    others = q.gather(-1, torch.tensor(_OTHERS)[largest[..., 0]])
    levels = ((others.double() * _SCALE + 1.0) * (0.5 * _STEPS)).round().clamp(0, _STEPS).int()
    levels[..., 0] |= (largest[..., 0].int() & 1) << 15
    levels[..., 1] |= (largest[..., 0].int() >> 1) << 15
    return torch.where(levels > 32767, levels - 65536, levels).to(torch.int16)


def unpack(packed: Tensor) -> Tensor:
    """Unit quaternions (..., 4) float32 of int16 (..., 3); any bits give some rotation.

    >>> unpack(pack(torch.tensor([0.0, 0.6, 0.0, -0.8]))).mul(1000).round().tolist()
    [0.0, -600.0, 0.0, 800.0]
    """
    levels = packed.int() & 0xFFFF
    largest = ((levels[..., 0] >> 15) | ((levels[..., 1] >> 15) << 1)).long()
    others = ((levels & 0x7FFF).float() * (2.0 / _STEPS) - 1.0) / _SCALE
    rest = (1.0 - others.square().sum(-1, keepdim=True)).clamp_min(0.0).sqrt()
    order = torch.tensor([[3, 0, 1, 2], [0, 3, 1, 2], [0, 1, 3, 2], [0, 1, 2, 3]])[largest]
    return rotations.normalize(torch.cat((others, rest), dim=-1).gather(-1, order))
