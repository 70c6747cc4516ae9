"""Packets: frames as the server sends them and pages carry them, and the skeleton that they move.

A packet is 32 bytes of header and the frames, little-endian throughout:

    magic "MVST" | u16 version | u16 joints J | u32 frames n | u64 first frame | f32 fps | f32 latency in ms | u32 flags
    float32[n, 3 + 4 J]     root position x y z in metres, then J local rotations as quaternions x y z w
    u8[n, 4]                if flag 1 is set: planted left ankle, left toe, right ankle, right toe

A take is one or more packets whose frames follow one another.
"""

import struct
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch
from torch import Tensor

from moveset.errors import FormatError, InputError
from moveset.io.limits import MAX_BYTES, MAX_FRAMES, MAX_NUMBER
from moveset.motion.clip import Motion
from moveset.motion.rigs import roles
from moveset.motion.skeleton import HML22, Skeleton

MAGIC = b"MVST"
VERSION = 1
CONTACTS = 1  # flag: planted feet follow the frames
HEADER = struct.Struct("<4sHHIQffI")


@dataclass(frozen=True, eq=False)
class Take:
    """What packets hold.

    Args:
        motion: all frames, float32.
        first_frame: number of the first one.
        planted: (F, 4) bool, or None where a packet does not say.
        latency_ms: of each packet.
    """

    motion: Motion
    first_frame: int
    planted: Tensor | None
    latency_ms: tuple[float, ...]


def pack_packet(
    motion: Motion, *, first_frame: int = 0, latency_ms: float = 0.0, planted: Tensor | None = None
) -> bytes:
    """A motion as one packet.

    Args:
        motion: F frames on a skeleton of at most 65,535 joints.
        first_frame: number of the first one.
        latency_ms: what making it took.
        planted: (F, 4) bool planted feet, if known.
    """
    frames, joints = motion.rotations.shape[:2]
    flags = 0 if planted is None else CONTACTS
    header = HEADER.pack(MAGIC, VERSION, joints, frames, first_frame, motion.fps, latency_ms, flags)
    feet = b"" if planted is None else planted.to(torch.uint8).contiguous().numpy().tobytes()
    return header + frame_rows(motion).tobytes() + feet


def frame_rows(motion: Motion) -> np.ndarray:
    """(F, 3 + 4 J) float32, little-endian: root position and local rotations of each frame."""
    return torch.cat((motion.root, motion.rotations.flatten(1)), dim=1).numpy().astype("<f4")


def unpack_packets(
    data: bytes, *, skeleton: Skeleton = HML22, max_bytes: int = MAX_BYTES, max_frames: int = MAX_FRAMES
) -> Take:
    """The take of one or more packets back to back.

    Args:
        data: as ``pack_packet`` made them.
        skeleton: what they must move.
        max_bytes, max_frames: limits.

    Raises:
        FormatError: anything else than whole packets of this version, of this skeleton and of one frame rate, whose
            frames follow one another and whose numbers are finite.
    """
    if len(data) > max_bytes:
        raise FormatError(f"the packets have {len(data):,} bytes, more than the limit of {max_bytes:,}; send fewer")
    rows: list[np.ndarray] = []
    feet: list[np.ndarray] = []
    latencies: list[float] = []
    at, begin, fps = 0, 0, 0.0
    expected: int | None = None
    while at < len(data) or not rows:
        packet = _header(data, at, len(skeleton))
        if expected is None:
            begin = packet.first_frame
        elif packet.first_frame != expected or packet.fps != fps:
            raise FormatError(
                f"a packet begins with frame {packet.first_frame} at {packet.fps:g} fps where frame {expected} at "
                f"{fps:g} fps should follow; send the packets of one take in order"
            )
        expected, fps = packet.first_frame + packet.frames, packet.fps
        if expected - begin > max_frames:
            raise FormatError(f"the packets have more than {max_frames:,} frames; send a shorter take")
        at += HEADER.size
        rows.append(np.frombuffer(data, "<f4", packet.floats, at).reshape(packet.frames, -1))
        at += 4 * packet.floats
        if packet.flags & CONTACTS:
            feet.append(np.frombuffer(data, np.uint8, 4 * packet.frames, at).reshape(-1, 4))
            at += 4 * packet.frames
        latencies.append(packet.latency_ms)
    values = torch.from_numpy(np.concatenate(rows).astype(np.float32))
    planted = torch.from_numpy(np.concatenate(feet)) != 0 if len(feet) == len(rows) else None
    return Take(_motion(values, fps, skeleton), begin, planted, tuple(latencies))


def skeleton_json(skeleton: Skeleton = HML22) -> dict[str, Any]:
    """What a client must know to draw frames: joints by name, parents, offsets in metres, and which are the feet.

    With ``roles`` (which joint is the pelvis, a knee, …) where a human skeleton's own names do not tell.
    """
    told = {
        "name": skeleton.name,
        "joints": list(skeleton.joints),
        "parents": list(skeleton.parents),
        "offsets": [[round(x, 7) for x in row] for row in skeleton.offsets.tolist()],
        "feet": list(skeleton.feet),
    }
    try:
        found = roles(skeleton)
    except InputError:  # no human: the names are all there is to know
        return told
    return told if all(skeleton.joints[j] == role for role, j in found.items()) else told | {"roles": found}


@dataclass(frozen=True)
class _Header:
    joints: int
    frames: int
    first_frame: int
    fps: float
    latency_ms: float
    flags: int

    @property
    def floats(self) -> int:
        return self.frames * (3 + 4 * self.joints)


def _header(data: bytes, at: int, joints: int) -> _Header:
    if len(data) - at < HEADER.size:
        raise FormatError(f"a packet's header needs {HEADER.size} bytes, but {len(data) - at} are left; send it whole")
    magic, version, *numbers = HEADER.unpack_from(data, at)
    if magic != MAGIC or version != VERSION:
        raise FormatError(f"no packet of version {VERSION} begins at byte {at}; send what the server sent")
    packet = _Header(*numbers)
    # The shortest decimal of that float, which is what was meant: 29.97, not 29.969999.
    packet = replace(packet, fps=float(str(np.float32(packet.fps))))
    if packet.joints != joints:
        raise FormatError(f"a packet has {packet.joints} joints, not {joints}; send frames of the server's skeleton")
    if packet.frames < 1 or not 0 < packet.fps <= 1000 or packet.flags & ~CONTACTS:
        raise FormatError(
            f"a packet has {packet.frames} frames at {packet.fps:g} fps and flags {packet.flags}; give at least one "
            "frame, at most 1000 fps, and no unknown flag"
        )
    size = 4 * packet.floats + (4 * packet.frames if packet.flags & CONTACTS else 0)
    if len(data) - at - HEADER.size < size:
        raise FormatError(f"a packet of {packet.frames} frames is cut short at byte {len(data)}; send it whole")
    return packet


def _motion(values: Tensor, fps: float, skeleton: Skeleton) -> Motion:
    if not bool(torch.isfinite(values).all()) or float(values.abs().max()) > MAX_NUMBER:
        raise FormatError(f"the packets hold numbers that are not finite or beyond {MAX_NUMBER:g}; send metres")
    turned = values[:, 3:].reshape(len(values), len(skeleton), 4)
    length = turned.norm(dim=-1, keepdim=True)
    if bool(((length - 1.0).abs() > 0.01).any()):
        raise FormatError("the packets hold rotations that are no unit quaternions; send x y z w of length 1")
    return Motion(turned / length, values[:, :3].clone(), fps, skeleton)
