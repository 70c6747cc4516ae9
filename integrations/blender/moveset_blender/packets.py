"""Packets, as a moveset server sends them and .mvst files hold them: a take is one or more back to back.

One packet is a 32-byte header, little-endian, and float32 (n, 3 + 4J): the root's position in metres (Y up, facing +Z)
and J local quaternions x y z w. With bit 0 of the flags u8 (n, 4) follows, whether each part of the feet stands.
"""

import struct

import numpy as np

from . import quaternions as quat
from .take import MotionError, Skeleton, Take

_HEADER = struct.Struct("<4sHHIQffI")
_CONTACTS = 1


def read_packets(data: bytes, skeleton: Skeleton, title: str = "take") -> Take:
    """The take that packets hold.

    Raises:
        MotionError: no packets, another version or skeleton, packets that do not follow each other, damaged numbers.
    """
    rows: list[np.ndarray] = []
    place, next_frame, fps = 0, None, 0.0
    width = 3 + 4 * len(skeleton.joints)
    while place < len(data):
        if len(data) - place < _HEADER.size:
            raise MotionError(f"the take ends within a header, at byte {place}; it is cut off")
        magic, version, joints, frames, first, rate, _, flags = _HEADER.unpack_from(data, place)
        place += _HEADER.size
        if magic != b"MVST" or version != 1 or flags & ~_CONTACTS:
            raise MotionError("this is no moveset take of version 1; give a .mvst file or an npz that moveset wrote")
        if joints != len(skeleton.joints):
            raise MotionError(
                f"the take has {joints} joints and {skeleton.name} has {len(skeleton.joints)}; save it as npz, which "
                "names its joints"
            )
        if next_frame not in (None, first) or (rows and rate != fps):
            raise MotionError(f"the packet of frame {first} does not follow the one before it; packets are missing")
        size = 4 * frames * width
        if len(data) - place < size + (4 * frames if flags & _CONTACTS else 0):
            raise MotionError(f"the take ends within the packet of frame {first}; it is cut off")
        rows.append(np.frombuffer(data, "<f4", frames * width, place).reshape(frames, width))
        place += size + (4 * frames if flags & _CONTACTS else 0)
        next_frame, fps = first + frames, rate
    if not rows:
        raise MotionError("the take is empty; make it again")
    whole = np.concatenate(rows).astype(np.float64)
    turns = whole[:, 3:].reshape(len(whole), -1, 4)
    take = Take(skeleton, fps, whole[:, :3], turns, title)
    return Take(skeleton, fps, take.root, quat.normalize(turns), title)
