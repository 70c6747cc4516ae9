"""Keyed noise: a pure function of seed, segment and sampler step.

So a sample does not depend on the order in which cells are evaluated, on the batch they are evaluated in, or on where a
stream was stopped and taken up again.
"""

import hashlib
import struct
from collections.abc import Sequence

import torch
from torch import Tensor

# Steps of noise that belongs to no sampler step: a segment's own start, and what is put back on it when it is finished
# and the next one is to be told it noisily.
START = -1
PAST = -3


def segment_noise(seed: int, segment: int, step: int, shape: Sequence[int]) -> Tensor:
    """Standard normal noise of one segment at one step, float32, drawn on the CPU: the same on every device.

    Args:
        seed: of the item, any integer of 64 bits.
        segment: number of the segment in its sequence.
        step: sampler step that the noise is added in, ``START`` or ``PAST``.
        shape: of the result.

    >>> float(segment_noise(1, 2, 3, (4,))[0]) == float(segment_noise(1, 2, 3, (4,))[0])
    True
    """
    # Torch's CPU generator looks at 32 bits of its seed: neighbouring keys must differ there, hence the hash. Two cells
    # agree by chance once in 4 billion pairs, and are then far apart.
    key = hashlib.blake2b(struct.pack("<qqq", seed, segment, step), digest_size=4).digest()
    return torch.randn(*shape, generator=torch.Generator().manual_seed(int.from_bytes(key, "little")))
