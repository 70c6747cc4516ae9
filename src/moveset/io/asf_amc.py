"""Acclaim ASF (skeleton) and AMC (motion), as the CMU Graphics Lab database uses them. F frames, J bones."""

import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NoReturn

import numpy as np
import torch
from torch import Tensor

from moveset.errors import FormatError
from moveset.io.limits import (
    MAX_BYTES,
    MAX_DEPTH,
    MAX_FRAMES,
    MAX_JOINTS,
    MAX_LINE,
    MAX_NUMBER,
    MAX_POSES,
    read_limited,
)
from moveset.motion import rotations

_INCH = 0.0254
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_NO_DIGITS = str.maketrans("", "", "0123456789+-.eE")
_BLOCK = 4096
_MAX_LINES = 4_000_000
_MAX_ASF_BYTES = 2**20
_DOFS = ("tx", "ty", "tz", "rx", "ry", "rz")


@dataclass(frozen=True, eq=False)
class AsfSkeleton:
    """An ASF skeleton in metres; bone 0 is the root, a point.

    Args:
        bones: J bone names, parents before children.
        parents: index of each bone's parent; -1 for the root.
        vectors: (J, 3) float64, each bone from its start to its end in the zero pose, metres; zero for the root.
        axes: (J, 4) float64 xyzw, the frame about whose axes a bone's angles turn.
        dofs: per bone the degrees of freedom its AMC line lists, such as ("rx", "rz"); locked ones are left out.
        metres: metres per unit of length in the AMC's root positions.
    """

    bones: tuple[str, ...]
    parents: tuple[int, ...]
    vectors: Tensor
    axes: Tensor
    dofs: tuple[tuple[str, ...], ...]
    metres: float

    def length(self, bone: str) -> float:
        """Length of a bone in metres."""
        return float(self.vectors[self.bones.index(bone)].norm())


@dataclass(frozen=True, eq=False)
class AmcTake:
    """Motion of an ASF skeleton.

    Args:
        rotations: (F, J, 4) float64 xyzw, rotation of each bone in its parent, away from the zero pose.
        root: (F, 3) float64 position of the root, metres.
    """

    skeleton: AsfSkeleton
    rotations: Tensor
    root: Tensor

    @cached_property
    def world(self) -> tuple[Tensor, Tensor]:
        """World rotations (F, J, 4), identity in the zero pose, and bone ENDS (F, J, 3) in metres."""
        turned, ends = [self.rotations[:, 0]], [self.root]
        for j, p in enumerate(self.skeleton.parents[1:], start=1):
            turned.append(rotations.mul(turned[p], self.rotations[:, j]))
            ends.append(ends[p] + rotations.rotate(turned[j], self.skeleton.vectors[j]))
        return torch.stack(turned, dim=1), torch.stack(ends, dim=1)


class _Lines:
    """Numbered, tokenised lines of a text file without comments and blanks."""

    def __init__(self, path: str | Path, max_bytes: int) -> None:
        self.path = path
        data = read_limited(path, max_bytes)
        if b"\0" in data:
            raise FormatError(f"{path} is not a text file; give an .asf or .amc file")
        if b"\r" in data:
            data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
        count = data.count(b"\n")
        if count > _MAX_LINES:
            raise FormatError(f"{path} has {count} lines, over the limit of {_MAX_LINES}; split the file")
        self.raw = data.decode("latin-1").split("\n")
        longest = max(map(len, self.raw), default=0)
        if longest > MAX_LINE:
            raise FormatError(f"{path} has a line of {longest} bytes, over the limit of {MAX_LINE}; it is damaged")

    def tokens(self) -> Iterator[tuple[int, list[str]]]:
        """Number and tokens of each line that has any."""
        for number, raw in enumerate(self.raw, start=1):
            tokens = (raw.split("#", 1)[0] if "#" in raw else raw).split()
            if tokens:
                yield number, tokens

    def fail(self, message: str, line: int) -> NoReturn:
        raise FormatError(f"{self.path}, line {line}: {message}")

    def number(self, token: str, line: int) -> float:
        if len(token) > 64 or not _NUMBER.fullmatch(token):
            self.fail(f"{token[:32]!r} is not a finite number; the file is damaged", line)
        value = float(token)
        if abs(value) > MAX_NUMBER:
            self.fail(f"{token[:32]} is beyond the limit of {MAX_NUMBER:g}; the file is damaged", line)
        return value

    def vector(self, tokens: list[str], line: int) -> list[float]:
        if len(tokens) < 3:
            self.fail("three numbers are needed; the file is damaged", line)
        return [self.number(token, line) for token in tokens[:3]]


@dataclass
class _Bone:
    line: int
    direction: list[float] | None = None
    length: float | None = None
    axis: Tensor | None = None
    dof: tuple[str, ...] = ()


def _frame(angles: list[float], order: str) -> Tensor:
    """The axis frame: for order "XYZ" R = Rz·Ry·Rx."""
    reverse = torch.tensor(angles[::-1], dtype=torch.float64)
    return rotations.from_euler(reverse, order[::-1])


def read_asf(path: str | Path) -> AsfSkeleton:
    """Parse an ASF skeleton.

    Its unit of length is ``1/length`` inch (``:units``), so metres are value x 0.0254 / length.

    Raises:
        InputError: the file cannot be read.
        FormatError: the file is damaged or over the limits of ``io.limits``.
    """
    lines = _Lines(path, _MAX_ASF_BYTES)
    length, degrees = 1.0, 1.0
    root_order: tuple[str, ...] = ("tx", "ty", "tz", "rx", "ry", "rz")
    root_axis, root_turn = "XYZ", [0.0, 0.0, 0.0]
    bones: dict[str, _Bone] = {}
    children: dict[str, list[str]] = {}
    section, name, bone = "", "", _Bone(0)
    number = 0
    for number, tokens in lines.tokens():
        key, rest = tokens[0].lower(), tokens[1:]
        if key.startswith(":"):
            section = key
        elif section == ":units":
            if key == "length":
                length = lines.number(rest[0] if rest else "", number)
                if not 1e-4 <= length <= 1e4:
                    lines.fail(f"a unit length of {length:g} is not in [0.0001, 10000]; the file is damaged", number)
            elif key == "angle":
                degrees = float(np.degrees(1.0)) if rest and rest[0].lower().startswith("rad") else 1.0
        elif section == ":root":
            if key == "order":
                root_order = tuple(token.lower() for token in rest)
                if sorted(root_order) != sorted(_DOFS):
                    lines.fail(f"the root order {' '.join(rest)[:64]!r} is not made of TX TY TZ RX RY RZ", number)
            elif key == "axis":
                root_axis = _axis_order(lines, rest[:1], number)
            elif key == "orientation":
                root_turn = [degrees * value for value in lines.vector(rest, number)]
        elif section == ":bonedata":
            if key == "begin":
                name, bone = "", _Bone(number)
            elif key == "name":
                name = rest[0] if rest else ""
                if not name or name in bones or name == "root":
                    lines.fail(f"the bone name {name[:32]!r} is empty or used twice; the file is damaged", number)
                if len(bones) >= MAX_JOINTS:
                    lines.fail(f"more than {MAX_JOINTS} bones; simplify the skeleton", number)
            elif key == "direction":
                bone.direction = lines.vector(rest, number)
                if not float(np.linalg.norm(bone.direction)) > 1e-6:
                    lines.fail("a bone's direction has no length; the file is damaged", number)
            elif key == "length":
                bone.length = lines.number(rest[0] if rest else "", number)
                if bone.length < 0:
                    lines.fail(f"a bone's length of {bone.length:g} is below 0; the file is damaged", number)
            elif key == "axis":
                angles = [degrees * value for value in lines.vector(rest, number)]
                bone.axis = _frame(angles, _axis_order(lines, rest[3:4], number))
            elif key == "dof":
                bone.dof = tuple(token.lower() for token in rest)
                if not set(bone.dof) <= set(_DOFS[3:]) or len(set(bone.dof)) != len(bone.dof):
                    lines.fail(f"degrees of freedom {' '.join(rest)[:64]!r} are not among rx ry rz", number)
            elif key == "end":
                if not name or bone.direction is None or bone.length is None or bone.axis is None:
                    lines.fail("a bone lacks its name, direction, length or axis; the file is damaged", number)
                bones[name] = bone
        elif section == ":hierarchy" and key not in ("begin", "end"):
            if tokens[0] in children:
                lines.fail(f"the children of {tokens[0][:32]!r} are listed twice; the file is damaged", number)
            children[tokens[0]] = rest
    order, parents = _tree(lines, bones, children, number)
    metres = _INCH / length
    vectors = torch.zeros(len(order), 3, dtype=torch.float64)
    axes = rotations.identity(len(order)).double()
    axes[0] = _frame(root_turn, root_axis)
    for j, key in enumerate(order[1:], start=1):
        direction = torch.tensor(bones[key].direction, dtype=torch.float64)
        vectors[j] = direction / direction.norm() * (bones[key].length or 0.0) * metres
        axis = bones[key].axis
        if axis is not None:
            axes[j] = axis
    dofs = (root_order, *(bones[key].dof for key in order[1:]))
    return AsfSkeleton(tuple(order), tuple(parents), vectors, axes, dofs, metres)


def _axis_order(lines: _Lines, tokens: list[str], line: int) -> str:
    order = tokens[0].upper() if tokens else "XYZ"
    if sorted(order) != ["X", "Y", "Z"]:
        lines.fail(f"the axis order {order[:32]!r} does not name X, Y and Z once each", line)
    return order


def _tree(
    lines: _Lines, bones: dict[str, _Bone], children: dict[str, list[str]], line: int
) -> tuple[list[str], list[int]]:
    """Bones reachable from the root, parents first: a walk along a list, so a cycle shows as a bone met twice."""
    order, parents, depth = ["root"], [-1], [0]
    for j, name in enumerate(order):  # the list grows while it is walked
        for child in children.get(name, []):
            if child not in bones:
                lines.fail(f"the hierarchy names a bone {child[:32]!r} that has no data; the file is damaged", line)
            if child in order:
                lines.fail(f"the hierarchy names the bone {child[:32]!r} twice; the file is damaged", line)
            if depth[j] + 1 > MAX_DEPTH:
                lines.fail(f"more than {MAX_DEPTH} levels of bones; simplify the skeleton", line)
            order.append(child)
            parents.append(j)
            depth.append(depth[j] + 1)
    missing = set(bones) - set(order)
    if missing or len(order) < 2:
        lines.fail(f"the hierarchy leaves out the bones {', '.join(sorted(missing))[:64] or '(all)'}", line)
    return order, parents


def read_amc(path: str | Path, asf: AsfSkeleton) -> AmcTake:
    """Parse an AMC motion of the skeleton ``asf``; its frame numbers may start anywhere but must count up by one.

    Raises:
        InputError: the file cannot be read.
        FormatError: the file is damaged, over the limits of ``io.limits``, or belongs to another skeleton.
    """
    lines = _Lines(path, MAX_BYTES)
    stream = lines.tokens()
    degrees = 1.0
    for _, tokens in stream:
        if _is_count(tokens[0]):
            break
        degrees = float(np.degrees(1.0)) if tokens[0].upper() == ":RADIANS" else degrees
    else:
        lines.fail("no frame begins with a number; this is no AMC file or it is truncated", len(lines.raw))
    widths = {name: len(dof) for name, dof in zip(asf.bones, asf.dofs, strict=True) if dof}
    layout: list[str] = []
    blocks: list[np.ndarray] = []
    block: list[tuple[int, list[str]]] = []
    frame, frames, place, number = int(tokens[0]), 1, 0, len(lines.raw)
    for number, tokens in stream:
        name = tokens[0]
        if _is_count(name) and len(tokens) == 1:
            if place < len(widths):
                lines.fail(f"frame {frame} lists {place} of the skeleton's {len(widths)} moving bones", number)
            if int(name) != frame + 1:
                lines.fail(f"frame {name} follows frame {frame}; the file has a gap", number)
            if frames == MAX_FRAMES or frames * len(asf.bones) > MAX_POSES:
                lines.fail(f"more than {MAX_FRAMES} frames or {MAX_POSES} poses; split the file", number)
            frame, frames, place = frame + 1, frames + 1, 0
            if len(block) > _BLOCK:
                blocks.append(_floats(lines, block))
                block = []
            continue
        if frames == 1 and name in widths and name not in layout:
            layout.append(name)
        if place >= len(layout) or name != layout[place] or len(tokens) != 1 + widths[name]:
            lines.fail(
                f"bone {name[:32]!r} with {len(tokens) - 1} values is not what the skeleton expects here; "
                "use the take's own .asf",
                number,
            )
        block.append((number, tokens))
        place += 1
    if place < len(widths):
        lines.fail(f"the last frame lists {place} of {len(widths)} bones; the file is truncated or damaged", number)
    blocks.append(_floats(lines, block))
    return _pose(asf, layout, np.concatenate(blocks).reshape(frames, -1), degrees)


def _is_count(token: str) -> bool:
    return len(token) <= 12 and token.isascii() and token.isdigit()


def _floats(lines: _Lines, block: list[tuple[int, list[str]]]) -> np.ndarray:
    flat = [token for _, tokens in block for token in tokens[1:]]
    try:
        # float() also takes "nan", "inf" and "1_0", which no AMC may hold.
        if "".join(flat).translate(_NO_DIGITS):
            raise ValueError
        values = np.fromiter(map(float, flat), dtype=np.float64, count=len(flat))
        if not np.abs(values).max() <= MAX_NUMBER:
            raise ValueError
    except ValueError:
        for number, tokens in block:
            for token in tokens[1:]:
                lines.number(token, number)
        lines.fail("a value is not a finite number; the file is damaged", block[0][0])
    return values


def _pose(asf: AsfSkeleton, layout: list[str], values: np.ndarray, degrees: float) -> AmcTake:
    frames = len(values)
    angles = torch.zeros(frames, len(asf.bones), 3, dtype=torch.float64)
    root = torch.zeros(frames, 3, dtype=torch.float64)
    root_turns = "".join(dof[1] for dof in asf.dofs[0] if dof[0] == "r")
    column = 0
    for name in layout:
        j = asf.bones.index(name)
        for dof in asf.dofs[j]:
            where = "xyz".index(dof[1])
            (root if dof[0] == "t" else angles[:, j])[:, where] = torch.from_numpy(values[:, column])
            column += 1
    angles *= degrees
    # R = Rz·Ry·Rx about the bone's own axes: C·R·C⁻¹ in the zero pose's world axes.
    turned = rotations.from_euler(angles.flip(-1), "ZYX")
    if root_turns != "xyz":
        order = root_turns[::-1]
        turned[:, 0] = rotations.from_euler(angles[:, 0, ["xyz".index(axis) for axis in order]], order)
    axes = asf.axes
    local = rotations.mul(rotations.mul(axes, turned), rotations.inv(axes))
    # The root's axes are its orientation in the zero pose, so it is not conjugated back.
    local[:, 0] = rotations.mul(axes[0], turned[:, 0])
    return AmcTake(asf, rotations.unroll(local), root * asf.metres)
