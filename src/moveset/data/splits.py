"""Which takes are for training, for validation and for testing.

Spans with human-written sentences say it themselves, and no second of a performance is on two sides: not by spans that
overlap, nor by the partner in the same scene. Without any, a take's name decides, the same forever.
"""

import hashlib
import re
from collections.abc import Iterable
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


def free_parts(start: int, stop: int, taken: Iterable[tuple[int, int]]) -> list[tuple[int, int]]:
    """What is left of frames [start, stop) without those that are taken.

    >>> free_parts(0, 10, [(2, 4), (3, 6), (9, 12)])
    [(0, 2), (6, 9)]
    """
    parts = []
    for first, last in sorted(taken):
        if last <= start or first >= stop:
            continue
        if first > start:
            parts.append((start, first))
        start = max(start, last)
    return [*parts, (start, stop)] if start < stop else parts


def overlap(a: tuple[int, int], b: tuple[int, int]) -> bool:
    """Whether two spans of frames share any."""
    return a[0] < b[1] and b[0] < a[1]
