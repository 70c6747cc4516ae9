"""The text of BVH files (Biovision hierarchy): a strict parser with limits. F frames, J joints, C channels."""

import re
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path
from typing import NoReturn

import numpy as np

from moveset.errors import FormatError
from moveset.io.limits import MAX_DEPTH, MAX_FRAMES, MAX_JOINTS, MAX_LINE, MAX_NUMBER, MAX_POSES, read_limited

_CHANNELS = {f"{axis}{kind}".lower(): f"{axis}{kind}" for kind in ("position", "rotation") for axis in "XYZ"}
_NUMBER = re.compile(rb"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
_DIGITS = b"0123456789+-.eE \t"
_BLOCK = 256
_MAX_HEADER_LINES = 100_000
_MAX_NAME = 128


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
        """Frames per second, rounded to a whole number where the frame time is within 0.01 % of one."""
        fps = 1.0 / self.frame_time
        return float(round(fps)) if abs(fps - round(fps)) < 1e-4 * fps else fps


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
            if self.line > _MAX_HEADER_LINES:
                self.fail(f"no frames within the first {_MAX_HEADER_LINES} lines; this is no BVH file")
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
    if not 1e-3 <= frame_time <= 100:
        reader.fail(f"a frame time of {frame_time:g} s is not in [0.001, 100]; export with a true frame rate")
    if reader.tokens:
        reader.fail(f"unexpected {_show(reader.tokens[0])} after the frame time; the file is damaged")
    if frames * len(joints) > MAX_POSES:
        reader.fail(f"{frames} frames of {len(joints)} joints exceed the limit of {MAX_POSES} poses; split the file")
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
                reader.fail(f"the joint name {name[:32]!r} is {'used twice' if name else 'empty'}; rename the joint")
            if len(name) > _MAX_NAME:
                reader.fail(f"a joint name of {len(name)} letters exceeds the limit of {_MAX_NAME}; rename the joint")
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
    """(F, C) values after the frame time, a block of lines at a time so that memory follows the file's size."""
    if width == 0:
        reader.fail("no joint has channels, so nothing moves; export the file with channels")
    size = len(reader.data) - reader.position
    if size < 2 * frames * width - 1:
        reader.fail(f"{size} bytes cannot hold {frames} frames of {width} values; the file is truncated")
    if reader.data.count(b"\n", reader.position) > 2 * frames + 1000:
        reader.fail(f"many more lines follow than the {frames} declared frames; the file is damaged")
    lines = reader.data[reader.position :].split(b"\n")
    numbered = [(number, line) for number, line in enumerate(lines, start=reader.line + 1) if line.strip()]
    if len(numbered) != frames:
        reader.fail(f"{frames} frames are declared and {len(numbered)} are there; the file is truncated or damaged")
    blocks = [_block(reader, numbered[k : k + _BLOCK], width) for k in range(0, frames, _BLOCK)]
    return np.concatenate(blocks)


def _block(reader: _Reader, numbered: list[tuple[int, bytes]], width: int) -> np.ndarray:
    """Some rows in one pass when all is well, in a second one to name the line that is not."""
    rows = [line.split() for _, line in numbered]
    for (number, line), row in zip(numbered, rows, strict=True):
        if len(line) > MAX_LINE:
            reader.fail(f"a line of {len(line)} bytes exceeds the limit of {MAX_LINE}; this is no BVH file", number)
        if len(row) != width:
            reader.fail(f"{len(row)} values for {width} channels; the file is truncated or damaged", number)
    try:
        # float() also takes "nan", "inf" and "1_0", which no BVH may hold.
        if b"".join(line for _, line in numbered).translate(None, _DIGITS):
            raise ValueError
        values = np.fromiter(map(float, chain.from_iterable(rows)), dtype=np.float64, count=len(rows) * width)
        if not np.abs(values).max() <= MAX_NUMBER:
            raise ValueError
    except ValueError:
        for number, line in numbered:
            reader.line = number
            for token in line.split():
                reader.number(token)
        reader.fail("a value is not a finite number; export the file again")
    return values.reshape(len(rows), width)
