"""Which takes are for training, for validation and for testing: decided by a take's name alone, the same forever."""

import hashlib
import re
from typing import Literal

Split = Literal["train", "val", "test"]

#: 60_NN and 61_NN of CMU are the two partners of one dance.
_SALSA = re.compile(r"(?:^|(?<=[_/-]))6[01]_(\d\d)$")


def split_of(name: str) -> Split:
    """Split of a take: 90 % train, 5 % val, 5 % test, by SHA-256 of its name.

    Clips cut from a take, mirrored takes and compositions inherit the split of their take, so no take is ever on two
    sides. The two partners of a salsa share a split.

    >>> split_of("60_04") == split_of("61_04")
    True
    """
    key = _SALSA.sub(r"salsa_\1", name)
    place = int.from_bytes(hashlib.sha256(key.encode()).digest()[:8], "big") / 2**64
    return "train" if place < 0.90 else "val" if place < 0.95 else "test"
