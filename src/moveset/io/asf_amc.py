"""Acclaim ASF (skeleton) and AMC (motion), as the CMU Graphics Lab database uses them. F frames, J bones."""

import re
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NoReturn

import numpy as np
import torch
from torch import Tensor

from moveset.errors import FormatError
from moveset.io.limits import MAX_DEPTH, MAX_FRAMES, MAX_JOINTS, MAX_LINE, MAX_NUMBER, read_limited
from moveset.motion import rotations

_INCH = 0.0254
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
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
        skeleton: the skeleton it belongs to.
        rotations: (F, J, 4) float64 xyzw, rotation of each bone in its parent, away from the zero pose.
        root: (F, 3) float64 position of the root, metres.
    """

    skeleton: AsfSkeleton
    rotations: Tensor
    root: Tensor

    def __len__(self) -> int:
        return len(self.root)

    def __getitem__(self, frames: slice) -> "AmcTake":
        return AmcTake(self.skeleton, self.rotations[frames], self.root[frames])

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

    def __init__(self, path: str | Path) -> None:
        self.path = path
        data = read_limited(path)
        if b"\0" in data:
            raise FormatError(f"{path} is not a text file; give an .asf or .amc file")
        self.raw = data.decode("latin-1").splitlines()
        longest = max(map(len, self.raw), default=0)
        if longest > MAX_LINE:
            raise FormatError(f"{path} has a line of {longest} bytes, over the limit of {MAX_LINE}; it is damaged")

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
    lines = _Lines(path)
    length, degrees = 1.0, 1.0
    root_order: tuple[str, ...] = ("tx", "ty", "tz", "rx", "ry", "rz")
    root_axis, root_turn = "XYZ", [0.0, 0.0, 0.0]
    bones: dict[str, _Bone] = {}
    children: dict[str, list[str]] = {}
    section, name, bone = "", "", _Bone(0)
    number = 0
    for number, raw in enumerate(lines.raw, start=1):
        tokens = raw.split("#", 1)[0].split()
        if not tokens:
            continue
        key, rest = tokens[0].lower(), tokens[1:]
        if key.startswith(":"):
            section = key
        elif section == ":units":
            if key == "length":
                length = lines.number(rest[0] if rest else "", number)
                if not 1e-4 <= length <= 1e4:
                    lines.fail(f"a unit length of {length:g} is not in [0.0001, 10000]; the file is damaged", number)
            elif key == "angle":
                degrees = float(np.degrees(1.0)) if rest[:1] == ["rad"] else 1.0
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
    lines = _Lines(path)
    start = next((k for k, raw in enumerate(lines.raw) if raw.strip().isdigit()), len(lines.raw))
    header = " ".join(lines.raw[:start]).upper()
    if start == len(lines.raw):
        lines.fail("no frame begins with a number; this is no AMC file or it is truncated", len(lines.raw))
    degrees = float(np.degrees(1.0)) if ":RADIANS" in header else 1.0
    rows = [(number, raw.split()) for number, raw in enumerate(lines.raw[start:], start=start + 1) if raw.strip()]
    rows = [(number, tokens) for number, tokens in rows if not tokens[0].startswith("#")]
    moving = sum(1 for dof in asf.dofs if dof)
    if len(rows) % (1 + moving):
        lines.fail(
            f"{len(rows)} lines are not whole frames of {moving} bones; the file is truncated, damaged or belongs to "
            "another skeleton",
            rows[-1][0],
        )
    frames = len(rows) // (1 + moving)
    if frames > MAX_FRAMES:
        lines.fail(f"{frames} frames exceed the limit of {MAX_FRAMES}; split the file", start + 1)
    widths = {name: len(dof) for name, dof in zip(asf.bones, asf.dofs, strict=True) if dof}
    layout = [tokens[0] for _, tokens in rows[1 : 1 + moving]]
    if sorted(layout) != sorted(widths):
        lines.fail("the first frame does not list every bone of the skeleton once; use the take's own .asf", start + 1)
    lengths = [2 if k == 0 else 1 + widths[layout[k - 1]] for k in range(1 + moving)]
    flat: list[str] = []
    expected = 0
    for k, (number, tokens) in enumerate(rows):
        place = k % (1 + moving)
        if place == 0:
            if len(tokens) != 1 or not tokens[0].isdigit() or len(tokens[0]) > 9:
                lines.fail(f"expected a frame number and found {tokens[0][:32]!r}; the file is damaged", number)
            if expected and int(tokens[0]) != expected:
                lines.fail(f"frame {tokens[0]} follows frame {expected - 1}; the file has a gap", number)
            expected = int(tokens[0]) + 1
        elif tokens[0] != layout[place - 1] or len(tokens) != lengths[place]:
            lines.fail(f"expected {lengths[place] - 1} values of bone {layout[place - 1]!r}", number)
        else:
            flat += tokens[1:]
    values = _floats(lines, rows, flat).reshape(frames, -1)
    return _pose(asf, layout, values, degrees)


def _floats(lines: _Lines, rows: list[tuple[int, list[str]]], flat: list[str]) -> np.ndarray:
    try:
        # float() also takes "nan", "inf" and "1_0", which no AMC may hold.
        if "".join(flat).translate(str.maketrans("", "", "0123456789+-.eE")):
            raise ValueError
        values = np.fromiter(map(float, flat), dtype=np.float64, count=len(flat))
        if not np.abs(values).max() <= MAX_NUMBER:
            raise ValueError
    except ValueError:
        for number, tokens in rows:
            for token in tokens[1:]:
                lines.number(token, number)
        raise
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
