"""The text of BVH files (Biovision hierarchy): a parser with limits. F frames, J joints, C channels.

It takes the spellings that Blender and three.js take: any case, ``Frames:4`` and ``Frames Time:``, rows more or one row
less than declared (with a warning). Whatever else is not as it should be is refused with its line and a remedy.
"""

import re
import warnings
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
MAX_NAME = 128
_SECONDS = (1e-3, 100.0)  # of a frame
_NTSC, _OF_NTSC = 1000.0 / 1001.0, 2e-4  # 29.97, 23.976 and 59.94 frames a second, and how far off they may be
_ROUNDED = 2e-7  # of a rate, by nine decimals of a frame time and by float32
# What names are written in: the first that fits all. BVH has no say in it; Japanese and Chinese tools use their own.
_ENCODINGS = ("utf-8", "cp932", "gb18030", "latin-1")


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
        """Frames per second: a whole number where the frame time is within 0.01 % of one."""
        return meant_rate(1.0 / self.frame_time, 1e-4)


def meant_rate(fps: float, off: float) -> float:
    """The rate that is meant by a measured one: the whole number within a share ``off`` of it, unless it is NTSC's, and
    else three decimals, where rounding explains the rest.

    >>> [meant_rate(fps, 0.01) for fps in (30.2, 29.97000003, 24000 / 1001)]
    [30.0, 29.97, 23.976023976023978]
    """
    whole, short = float(round(fps)), round(fps, 3)
    if abs(fps - whole) < off * fps and abs(fps - whole * _NTSC) > _OF_NTSC * fps:
        return whole
    return short if abs(fps - short) < _ROUNDED * fps else fps


@dataclass
class _Joint:
    name: bytes
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

    def keywords(self, *words: bytes) -> bytes:
        """One of some words in capitals, and a colon behind it or not, with or without blanks."""
        token = self.token()
        word, colon, rest = token.partition(b":")
        if word.upper() not in words:
            self.fail(f"expected {words[0].decode()!r} and found {_show(token)}; the file is damaged")
        if not colon and self.tokens and self.tokens[0].startswith(b":"):
            rest = self.tokens.pop(0)[1:]
        if rest:
            self.tokens.insert(0, rest)
        return word.upper()

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
            if _NUMBER.fullmatch(token.replace(b",", b".", 1)):
                self.fail(f"{_show(token)} has a decimal comma; export the file with decimal points")
            if token.endswith((b"\0", b"\x1a")):
                self.fail("NUL or Ctrl-Z bytes stand behind a number, as DOS ends files; delete them")
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


def read_bvh(path: str | Path, *, fps: float | None = None) -> BvhFile:
    """Parse a BVH file.

    Args:
        fps: frames per second, whatever the file says.

    Raises:
        InputError: the file cannot be read.
        FormatError: anything in it is missing, doubled, absurd, not finite, or over the limits of ``io.limits``.
    """
    data = read_limited(path).removeprefix(b"\xef\xbb\xbf")
    if data[:2] in (b"\xff\xfe", b"\xfe\xff") or b"\0" in data[:16]:
        raise FormatError(f"{path}, line 1: this is no plain text, UTF-16 perhaps; save it as UTF-8")
    if b"\r" in data:
        data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    reader = _Reader(path, data)
    reader.expect(b"HIERARCHY")
    joints, end_sites = _hierarchy(reader)
    after = reader.token()
    if after.upper() == b"ROOT":
        reader.fail("a second ROOT: there are several bodies in this file; export each to a file of its own")
    reader.tokens.insert(0, after)
    reader.expect(b"MOTION")
    frames, frame_time = _timing(reader, fps)
    values = _frames(reader, frames, len(joints), sum(len(joint.channels or ()) for joint in joints))
    return BvhFile(
        joints=_names([joint.name for joint in joints]),
        parents=tuple(joint.parent for joint in joints),
        offsets=np.array([joint.offset for joint in joints], dtype=np.float64),
        channels=tuple(joint.channels or () for joint in joints),
        end_sites=end_sites,
        frame_time=frame_time,
        values=values,
    )


def _names(raw: list[bytes]) -> tuple[str, ...]:
    """Joint names in the first encoding that all of them are in; as different from each other as their bytes are."""
    for encoding in _ENCODINGS:
        try:
            names = tuple(name.decode(encoding) for name in raw)
        except UnicodeDecodeError:
            continue
        if len(set(names)) == len(raw):
            return names
    raise AssertionError("latin-1 takes any bytes, one letter each")


def _timing(reader: _Reader, fps: float | None) -> tuple[int, float]:
    """The declared number of frames, and seconds per frame."""
    reader.keywords(b"FRAMES", b"FRAME")
    frames = reader.count(reader.token(), MAX_FRAMES, "frames")
    if frames < 1:
        reader.fail("the file declares no frames; export at least one")
    if reader.tokens and not reader.tokens[0].upper().startswith(b"FRAME"):
        reader.tokens.clear()  # a remark
    if reader.keywords(b"FRAME", b"FRAMES", b"FRAMETIME") != b"FRAMETIME":
        reader.keywords(b"TIME")
    token = reader.token()
    frame_time = 1.0 / fps if fps is not None else reader.number(token)
    if not _SECONDS[0] <= frame_time <= _SECONDS[1]:
        reader.fail(f"a frame time of {frame_time:g} s is not in {list(_SECONDS)}; give the true rate by --source-fps")
    if reader.tokens and _NUMBER.match(reader.tokens[0]):
        reader.fail(f"unexpected {_show(reader.tokens[0])} after the frame time; the file is damaged")
    reader.tokens.clear()
    return frames, frame_time


def _hierarchy(reader: _Reader) -> tuple[list[_Joint], tuple[tuple[int, tuple[float, float, float]], ...]]:
    """The joint tree, by a loop over tokens with an explicit stack: depth is limited, nothing recurses."""
    joints: list[_Joint] = []
    names: set[bytes] = set()
    end_sites: list[tuple[int, tuple[float, float, float]]] = []
    stack: list[int] = []
    while stack or not joints:
        word = reader.token().upper()
        if word == (b"JOINT" if joints else b"ROOT"):
            name = b" ".join(reader.rest_of_line())
            if not name or name in names:
                reader.fail(f"the joint name {_show(name)} is {'used twice' if name else 'empty'}; rename the joint")
            if len(name) > MAX_NAME:
                reader.fail(f"a joint name of {len(name)} bytes exceeds the limit of {MAX_NAME}; rename the joint")
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
                reader.fail(f"joint {_show(joints[stack[-1]].name)} has two OFFSET lines; the file is damaged")
            joints[stack[-1]].offset = reader.vector()
        elif word == b"CHANNELS":
            if joints[stack[-1]].channels is not None:
                reader.fail(f"joint {_show(joints[stack[-1]].name)} has two CHANNELS lines; the file is damaged")
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
                where = f"joint {_show(joint.name)} (line {joint.line})"
                reader.fail(f"{where} lacks its OFFSET or CHANNELS; the file is damaged")
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


def _frames(reader: _Reader, frames: int, joints: int, width: int) -> np.ndarray:
    """(F, C) values after the frame time, a block of lines at a time so that memory follows the file's size."""
    if width == 0:
        reader.fail("no joint has channels, so nothing moves; export the file with channels")
    size = len(reader.data) - reader.position
    if size < 2 * (frames - 1) * width - 1:
        reader.fail(f"{size} bytes cannot hold {frames} frames of {width} values; the file is truncated")
    if reader.data.count(b"\n", reader.position) > 2 * frames + 1000:
        reader.fail(f"many more lines follow than the {frames} declared frames; the file is damaged")
    lines = reader.data[reader.position :].split(b"\n")
    numbered = [(number, line) for number, line in enumerate(lines, start=reader.line + 1) if line.strip()]
    count = len(numbered)
    for number, line in numbered[frames:]:
        # Words that some programs leave behind, or Ctrl-Z and NULs, where DOS ended files.
        if not _NUMBER.match(line.lstrip()):
            reader.fail(f"{_show(line.strip())} after the last frame is no row of numbers; delete this line", number)
    # Rokoko counts one too few, others one too many; fewer are there where the file was cut off.
    if count < max(frames - 1, 1):
        reader.fail(f"{frames} frames are declared and {count} are there; the file is truncated or damaged")
    if count * joints > MAX_POSES or count > MAX_FRAMES:
        reader.fail(f"{count} frames of {joints} joints exceed the limit of {MAX_POSES} poses; split the file")
    blocks = [_block(reader, numbered[k : k + _BLOCK], width) for k in range(0, count, _BLOCK)]
    if count != frames:
        said = f"{frames} frames are declared and {count} are there, which are read"
        warnings.warn(f"{reader.path}: {said}; see whether the end is as it should be", stacklevel=3)
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
