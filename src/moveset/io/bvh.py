"""BVH (Biovision hierarchy): a strict reader with limits. F frames, J joints, C channels."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import NoReturn

import numpy as np
import torch
from torch import Tensor

from moveset.errors import FormatError
from moveset.io.limits import MAX_DEPTH, MAX_FRAMES, MAX_JOINTS, MAX_LINE, MAX_NUMBER, read_limited
from moveset.motion import rotations

_CHANNELS = {f"{axis}{kind}".lower(): f"{axis}{kind}" for kind in ("position", "rotation") for axis in "XYZ"}
_NUMBER = re.compile(rb"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_DIGITS = b"0123456789+-.eE \t"


@dataclass(frozen=True, eq=False)
class BvhFile:
    """What a BVH file says, in its own units, axes and order.

    Args:
        joints: J joint names, parents before children.
        parents: index of each joint's parent; -1 for the root.
        offsets: (J, 3) float64 OFFSET of each joint.
        channels: per joint, its channel names such as "Xposition" or "Zrotation", in file order.
        end_sites: (parent index, offset (3,)) of each End Site.
        frame_time: seconds per frame.
        values: (F, C) float64, degrees and length units, in file order.
    """

    joints: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: np.ndarray
    channels: tuple[tuple[str, ...], ...]
    end_sites: tuple[tuple[int, tuple[float, float, float]], ...]
    frame_time: float
    values: np.ndarray

    @property
    def fps(self) -> float:
        """Frames per second, rounded to a whole number where the frame time is within 0.1 % of one."""
        fps = 1.0 / self.frame_time
        return float(round(fps)) if abs(fps - round(fps)) < 1e-3 * fps else fps


@dataclass
class _Joint:
    name: str
    parent: int
    depth: int
    line: int
    offset: tuple[float, float, float] | None = None
    channels: tuple[str, ...] | None = None


@dataclass
class _Reader:
    """Lines and tokens of a file with their line numbers, without ever holding them all."""

    path: str | Path
    data: bytes
    position: int = 0
    line: int = 0
    tokens: list[bytes] = field(default_factory=list)

    def fail(self, message: str, line: int | None = None) -> NoReturn:
        raise FormatError(f"{self.path}, line {self.line if line is None else line}: {message}")

    def next_line(self) -> list[bytes]:
        """Tokens of the next line that has any."""
        while self.position < len(self.data):
            end = self.data.find(b"\n", self.position)
            end = len(self.data) if end < 0 else end
            start, self.position, self.line = self.position, end + 1, self.line + 1
            if end - start > MAX_LINE:
                self.fail(f"a line of {end - start} bytes exceeds the limit of {MAX_LINE}; this is no BVH file")
            tokens = self.data[start:end].split()
            if tokens:
                return tokens
        self.fail("the file ends too early; it is truncated, export it again")

    def token(self) -> bytes:
        if not self.tokens:
            self.tokens = self.next_line()
        return self.tokens.pop(0)

    def rest_of_line(self) -> list[bytes]:
        """Tokens left on this line, up to an opening brace."""
        stop = self.tokens.index(b"{") if b"{" in self.tokens else len(self.tokens)
        taken, self.tokens = self.tokens[:stop], self.tokens[stop:]
        return taken

    def expect(self, word: bytes) -> None:
        token = self.token()
        if token.upper() != word.upper():
            self.fail(f"expected {word.decode()!r} and found {_show(token)}; the file is damaged")

    def number(self, token: bytes) -> float:
        if len(token) > 64 or not _NUMBER.fullmatch(token):
            self.fail(f"{_show(token)} is not a finite number; export the file again")
        value = float(token)
        if abs(value) > MAX_NUMBER:
            self.fail(f"{_show(token)} is beyond the limit of {MAX_NUMBER:g}; use a smaller unit of length")
        return value

    def vector(self) -> tuple[float, float, float]:
        return self.number(self.token()), self.number(self.token()), self.number(self.token())

    def count(self, token: bytes, limit: int, what: str) -> int:
        if not token.isdigit() or len(token) > 12:
            self.fail(f"{_show(token)} is not a number of {what}; the file is damaged")
        if int(token) > limit:
            self.fail(f"{int(token)} {what} exceed the limit of {limit}; split the file")
        return int(token)


def _show(token: bytes) -> str:
    text = token[:32].decode("utf-8", "replace")
    return repr(text if len(token) <= 32 else text + "…")


def read_bvh(path: str | Path) -> BvhFile:
    """Parse a BVH file strictly.

    Raises:
        InputError: the file cannot be read.
        FormatError: anything in it is missing, doubled, absurd, not finite, or over the limits of ``io.limits``.
    """
    data = read_limited(path).removeprefix(b"\xef\xbb\xbf")
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    reader = _Reader(path, data)
    reader.expect(b"HIERARCHY")
    joints, end_sites = _hierarchy(reader)
    reader.expect(b"MOTION")
    reader.expect(b"Frames:")
    frames = reader.count(reader.token(), MAX_FRAMES, "frames")
    if frames < 1:
        reader.fail("the file declares no frames; export at least one")
    reader.expect(b"Frame")
    reader.expect(b"Time:")
    frame_time = reader.number(reader.token())
    if not 1e-4 <= frame_time <= 100:
        reader.fail(f"a frame time of {frame_time:g} s is not in [0.0001, 100]; export with a true frame rate")
    if reader.tokens:
        reader.fail(f"unexpected {_show(reader.tokens[0])} after the frame time; the file is damaged")
    values = _frames(reader, frames, sum(len(joint.channels or ()) for joint in joints))
    return BvhFile(
        joints=tuple(joint.name for joint in joints),
        parents=tuple(joint.parent for joint in joints),
        offsets=np.array([joint.offset for joint in joints], dtype=np.float64),
        channels=tuple(joint.channels or () for joint in joints),
        end_sites=end_sites,
        frame_time=frame_time,
        values=values,
    )


def _hierarchy(reader: _Reader) -> tuple[list[_Joint], tuple[tuple[int, tuple[float, float, float]], ...]]:
    """The joint tree, by a loop over tokens with an explicit stack: depth is limited, nothing recurses."""
    joints: list[_Joint] = []
    names: set[str] = set()
    end_sites: list[tuple[int, tuple[float, float, float]]] = []
    stack: list[int] = []
    while stack or not joints:
        word = reader.token().upper()
        if word == (b"JOINT" if joints else b"ROOT"):
            name = b" ".join(reader.rest_of_line()).decode("utf-8", "replace")
            if not name or name in names:
                reader.fail(f"the joint name {name[:64]!r} is {'used twice' if name else 'empty'}; rename the joint")
            if len(joints) >= MAX_JOINTS or len(stack) >= MAX_DEPTH:
                reader.fail(f"more than {MAX_JOINTS} joints or {MAX_DEPTH} levels of them; simplify the skeleton")
            reader.expect(b"{")
            joints.append(_Joint(name, stack[-1] if stack else -1, len(stack), reader.line))
            names.add(name)
            stack.append(len(joints) - 1)
        elif not joints:
            reader.fail(f"expected 'ROOT' and found {_show(word)}; the file is damaged")
        elif word == b"OFFSET":
            if joints[stack[-1]].offset is not None:
                reader.fail(f"joint {joints[stack[-1]].name!r} has two OFFSET lines; the file is damaged")
            joints[stack[-1]].offset = reader.vector()
        elif word == b"CHANNELS":
            if joints[stack[-1]].channels is not None:
                reader.fail(f"joint {joints[stack[-1]].name!r} has two CHANNELS lines; the file is damaged")
            joints[stack[-1]].channels = _channels(reader)
        elif word == b"END":
            reader.rest_of_line()
            reader.expect(b"{")
            reader.expect(b"OFFSET")
            end_sites.append((stack[-1], reader.vector()))
            reader.expect(b"}")
            if len(end_sites) > 2 * MAX_JOINTS:
                reader.fail(f"more than {2 * MAX_JOINTS} End Sites; simplify the skeleton")
        elif word == b"}":
            joint = joints[stack.pop()]
            if joint.offset is None or joint.channels is None:
                reader.fail(
                    f"joint {joint.name!r} (line {joint.line}) lacks its OFFSET or CHANNELS; the file is damaged"
                )
        else:
            reader.fail(f"expected a joint, OFFSET, CHANNELS or '}}' and found {_show(word)}; the file is damaged")
    return joints, tuple(end_sites)


def _channels(reader: _Reader) -> tuple[str, ...]:
    count = reader.count(reader.token(), 6, "channels")
    tokens = [reader.token() for _ in range(count)]
    names = tuple(_CHANNELS.get(token.decode("utf-8", "replace").lower(), "") for token in tokens)
    if "" in names:
        reader.fail(f"{_show(tokens[names.index('')])} is not a channel; use X/Y/Zposition and X/Y/Zrotation")
    if len(set(names)) != count:
        reader.fail(f"the same channel is listed twice in {' '.join(names)}; the file is damaged")
    return names


def _frames(reader: _Reader, frames: int, width: int) -> np.ndarray:
    """(F, C) values after the frame time: one pass when all is well, a second one to name the line that is wrong."""
    first = reader.line + 1
    if width == 0:
        reader.fail("no joint has channels, so nothing moves; export the file with channels")
    if reader.data.count(b"\n", reader.position) > 2 * frames + 1000:
        reader.fail(f"many more lines follow than the {frames} declared frames; the file is damaged")
    lines = reader.data[reader.position :].split(b"\n")
    while lines and not lines[-1].strip():
        lines.pop()
    rows = [line.split() for line in lines]
    if not all(len(row) == width for row in rows):
        numbered = [(first + k, row) for k, row in enumerate(rows) if row]
        for number, row in numbered:
            if len(row) != width:
                what = "the file ends too early or is damaged" if number == numbered[-1][0] else "the file is damaged"
                reader.fail(f"{len(row)} values for {width} channels; {what}", number)
        rows = [row for _, row in numbered]
    if len(rows) != frames:
        reader.fail(f"{frames} frames are declared and {len(rows)} are there; the file is truncated or damaged", first)
    if max(map(len, lines)) > MAX_LINE:
        reader.fail(f"a line exceeds the limit of {MAX_LINE} bytes; this is no BVH file", first)
    if b"".join(lines).translate(None, _DIGITS):
        _find_bad_number(reader, lines, first)
    try:
        values = np.fromiter(map(float, chain.from_iterable(rows)), dtype=np.float64, count=frames * width)
    except ValueError:
        _find_bad_number(reader, lines, first)
    if not np.abs(values).max() <= MAX_NUMBER:
        _find_bad_number(reader, lines, first)
    return values.reshape(frames, width)


def _find_bad_number(reader: _Reader, lines: list[bytes], first: int) -> NoReturn:
    for number, line in enumerate(lines, start=first):
        reader.line = number
        for token in line.split():
            reader.number(token)
    reader.fail("a value is not a finite number; export the file again", first)


@dataclass(frozen=True, eq=False)
class LocalFrames:
    """A BVH file as local rotations: (F, J, 4) xyzw float64, root positions (F, 3), in the file's length unit."""

    joints: tuple[str, ...]
    parents: tuple[int, ...]
    offsets: Tensor
    rotations: Tensor
    root: Tensor
    stretch: Tensor

    def world(self) -> tuple[Tensor, Tensor]:
        """World rotations (F, J, 4) and positions (F, J, 3) by forward kinematics."""
        turned, placed = [self.rotations[:, 0]], [self.root]
        for j, p in enumerate(self.parents[1:], start=1):
            turned.append(rotations.mul(turned[p], self.rotations[:, j]))
            placed.append(placed[p] + rotations.rotate(turned[p], self.offsets[j]))
        return torch.stack(turned, dim=1), torch.stack(placed, dim=1)


def local_frames(bvh: BvhFile, *, root: str | None = None) -> LocalFrames:
    """Local rotations and root path, continuous in sign, with motion that sits in a child of the root folded upwards.

    Position channels replace the OFFSET of their joint. Some files keep the root joint still and move its only child,
    others do both: such roots are composed into their child and dropped.

    Args:
        root: fold down to this joint; without it, as long as the root's only child moves.
    """
    quats, places = _local(bvh)
    moves = (places - places[:1]).abs().amax(dim=(0, 2))
    first = bvh.joints.index(root) if root is not None else 0
    while root is None and bvh.parents.count(first) == 1 and moves[bvh.parents.index(first)] > 1e-6:
        first = bvh.parents.index(first)
    turn, place = quats[:, 0], places[:, 0]
    for j in _path(bvh.parents, first):
        place = place + rotations.rotate(turn, places[:, j])
        turn = rotations.mul(turn, quats[:, j])
    keep = [first, *_descendants(bvh.parents, first)]
    offsets = places[:, keep].mean(dim=0)
    offsets[0] = 0.0
    stretch = (places[:, keep] - offsets).norm(dim=-1).amax(dim=0)
    stretch[0] = 0.0
    kept = torch.cat((turn[:, None], quats[:, keep[1:]]), dim=1)
    return LocalFrames(
        joints=tuple(bvh.joints[j] for j in keep),
        parents=(-1, *(keep.index(bvh.parents[j]) for j in keep[1:])),
        offsets=offsets,
        rotations=rotations.unroll(kept),
        root=place,
        stretch=stretch,
    )


def _path(parents: tuple[int, ...], joint: int) -> list[int]:
    path: list[int] = []
    while joint > 0:
        path.insert(0, joint)
        joint = parents[joint]
    return path


def _descendants(parents: tuple[int, ...], joint: int) -> Iterator[int]:
    inside = {joint}
    for j, p in enumerate(parents):
        if p in inside:
            inside.add(j)
            yield j


def _local(bvh: BvhFile) -> tuple[Tensor, Tensor]:
    """Rotation (F, J, 4) and position (F, J, 3) of every joint in its parent, float64."""
    values = torch.from_numpy(bvh.values)
    frames, joints = len(values), len(bvh.joints)
    quats = rotations.identity(frames, joints).double()
    places = torch.from_numpy(bvh.offsets).expand(frames, joints, 3).clone()
    by_order: dict[str, list[tuple[int, list[int]]]] = {}
    column = 0
    for j, names in enumerate(bvh.channels):
        turns = [(name[0], column + k) for k, name in enumerate(names) if name.endswith("rotation")]
        if turns:
            by_order.setdefault("".join(axis for axis, _ in turns), []).append((j, [c for _, c in turns]))
        for k, name in enumerate(names):
            if name.endswith("position"):
                places[:, j, "XYZ".index(name[0])] = values[:, column + k]
        column += len(names)
    for order, members in by_order.items():
        columns = torch.tensor([c for _, c in members])
        quats[:, [j for j, _ in members]] = rotations.from_euler(values[:, columns], order)
    return quats, places
