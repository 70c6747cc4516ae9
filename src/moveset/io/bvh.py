"""BVH (Biovision hierarchy) to ``Motion`` and back. F frames, J joints."""

import re
import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from moveset.errors import FormatError, InputError
from moveset.io.bvh_parser import MAX_NAME, BvhFile
from moveset.io.limits import MAX_DEPTH, MAX_FRAMES, MAX_JOINTS, MAX_POSES, atomic_write
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.retarget import retarget
from moveset.motion.skeleton import HML22, Skeleton
from moveset.motion.units import bone_reach, likely_unit

CENTIMETRES = 0.01
_PER_METRE, _ORDER = 1.0 / CENTIMETRES, "ZXY"  # of files that are written
_TIP = 0.1
_TIP_ROUNDING = 1e-3  # of a tip: digits of a short bone tell its direction no better
_UNITS = (1.0, 0.01, 0.001)
# Parts of a body's reach: less movement of a joint inside its parent is rounding, more is not a skeleton's.
ROUNDING, STRETCH = 1e-4, 0.02


@dataclass(frozen=True, eq=False)
class LocalFrames:
    """A BVH file as local rotations on one skeleton, in the file's unit of length; float64.

    Args:
        joints: J joint names, parents before children.
        parents: index of each joint's parent; -1 for the root.
        offsets: (J, 3) mean position of each joint in its parent; zero for the root.
        rotations: (F, J, 4) local rotations xyzw, signs continuous in time.
        root: (F, 3) position of the root.
        stretch: (J,) farthest that a joint ever is from its offset.
    """

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
    """Local rotations and root path, with motion that sits in a child of the root folded upwards.

    Position channels replace the OFFSET of their joint. Some files keep the root joint still and move its only child,
    others move both: such roots are composed into their child and dropped, which changes no joint below.

    Args:
        root: fold down to this joint; without it, as long as the root's only child moves within it.

    Raises:
        FormatError: there is no joint called ``root``.
    """
    if root is not None and root not in bvh.joints:
        raise FormatError(f"the file has no joint {root!r}; its joints are {', '.join(bvh.joints)[:200]}")
    quats, places = _local(bvh)
    moves = (places - places[:1]).abs().amax(dim=(0, 2))
    first = bvh.joints.index(root) if root is not None else 0
    limit = ROUNDING * bone_reach(bvh.parents, places.mean(dim=0))
    while root is None and bvh.parents.count(first) == 1 and moves[bvh.parents.index(first)] > limit:
        first = bvh.parents.index(first)
    way = [first]
    while way[0] > 0:
        way.insert(0, bvh.parents[way[0]])
    turn, place = quats[:, 0], places[:, 0]
    for j in way[1:]:
        place = place + rotations.rotate(turn, places[:, j])
        turn = rotations.mul(turn, quats[:, j])
    keep = [first]
    for j, p in enumerate(bvh.parents):
        if p in keep:
            keep.append(j)
    new = {j: k for k, j in enumerate(keep)}
    offsets = places[:, keep].mean(dim=0)
    stretch = (places[:, keep] - offsets).norm(dim=-1).amax(dim=0)
    offsets[0], stretch[0] = 0.0, 0.0
    return LocalFrames(
        joints=tuple(bvh.joints[j] for j in keep),
        parents=(-1, *(new[bvh.parents[j]] for j in keep[1:])),
        offsets=offsets,
        rotations=rotations.unroll(torch.cat((turn[:, None], quats[:, keep[1:]]), dim=1)),
        root=place,
        stretch=stretch,
    )


def likely_scale(bvh: BvhFile) -> float:
    """Metres per unit. Files of ``write_bvh`` say it by their End Sites, each 10 cm along its bone; of others it is
    guessed by the size of the body (``motion.units``)."""
    if (scale := _scale_of_tips(bvh)) is not None:
        return scale
    return likely_unit(Skeleton("bvh", bvh.joints, bvh.parents, _local(bvh)[1].mean(dim=0)))


def _scale_of_tips(bvh: BvhFile) -> float | None:
    """Metres per unit of a file of ``write_bvh``; None for others."""
    if not bvh.end_sites or bvh.offsets[0].any():
        return None
    found = np.array([tip for _, tip in bvh.end_sites])
    for scale in _UNITS:
        tips = np.array([_tip(bvh.offsets[joint].tolist(), 1.0 / scale) for joint, _ in bvh.end_sites])
        if np.abs(found - tips).max() < _TIP_ROUNDING * _TIP / scale:
            return scale
    return None


def bvh_motion(bvh: BvhFile, *, scale: float = CENTIMETRES) -> Motion:
    """The motion of a BVH file on the file's own skeleton, or on ``HML22`` where that is what it is.

    Args:
        scale: metres per unit of the file: 0.01 for centimetres, which most files use and ``write_bvh`` writes; see
            ``likely_scale``.

    Bones that stretch, as depth cameras see them, get their mean lengths, with a warning.
    """
    frames = local_frames(bvh)
    warn_of_stretch(frames.joints, frames.stretch * scale, bone_reach(frames.parents, frames.offsets) * scale)
    turned = rotations.normalize(frames.rotations).float()
    root, offsets = (frames.root * scale).float(), (frames.offsets * scale).float()
    motion = Motion(turned, root, bvh.fps, Skeleton("bvh", frames.joints, frames.parents, offsets))
    # Files list joints depth first.
    return motion if HML22.order_in(motion.skeleton) is None else retarget(motion, HML22)


def warn_of_stretch(joints: Sequence[str], stretch: Tensor, reach: float) -> None:
    """Warn where joints (J,) slide within their parents by more than fixed bones forgive: 2 % of the body's reach."""
    sliding = [j for j in stretch.argsort(descending=True).tolist() if float(stretch[j]) > STRETCH * reach]
    if sliding:
        names = ", ".join(f"{joints[j]!r} by {float(stretch[j]):.3g} m" for j in sliding[:3]) + ", …" * (
            len(sliding) > 3
        )
        warnings.warn(
            f"joints slide within their parents ({names}); bones keep their mean lengths, so joints end elsewhere than "
            "in the file",
            stacklevel=3,
        )


def write_bvh(motion: Motion, path: str | Path) -> Path:
    """Write a motion as BVH in centimetres, which animation software expects, whole or not at all.

    The root has six channels, the others three, rotations R = Rz·Rx·Ry; joints without children end in an End Site that
    prolongs their bone by 10 cm. Angles are continuous in time, also beyond 180 degrees and through a middle angle of
    90 degrees, so that they can be interpolated and edited as curves.

    Raises:
        InputError: ``path`` cannot be written, or the motion is over the limits that BVH files are read with.
    """
    path = Path(path)
    text = BvhText(motion.skeleton, motion.fps)
    if len(motion) > MAX_FRAMES or len(motion) * len(motion.skeleton) > MAX_POSES:
        raise InputError(
            f"{len(motion)} frames of {len(motion.skeleton)} joints exceed what is read back ({MAX_FRAMES} frames, "
            f"{MAX_POSES} poses); write shorter pieces"
        )
    with atomic_write(path) as file:
        file.write(text.head(str(len(motion))) + text.rows(motion))
    return path


class BvhText:
    """The text of a BVH file, frames as they come: each piece's angles continue those of the piece before.

    Raises:
        InputError: the skeleton is over the limits that BVH files are read with.
    """

    def __init__(self, skeleton: Skeleton, fps: float) -> None:
        if len(skeleton) > MAX_JOINTS or len(skeleton.levels) > MAX_DEPTH:
            raise InputError(
                f"{len(skeleton)} joints in {len(skeleton.levels)} levels exceed what is read back "
                f"({MAX_JOINTS}, {MAX_DEPTH}); simplify the skeleton"
            )
        self._lines, self._joints = _hierarchy_text(skeleton)
        self._fps = fps
        self._before: np.ndarray | None = None

    def head(self, frames: str) -> bytes:
        """Everything before the rows; ``frames`` is their number, padded if wanted."""
        return "\n".join(
            [*self._lines, "MOTION", f"Frames: {frames}", f"Frame Time: {1.0 / self._fps:.9f}", ""]
        ).encode()

    def rows(self, motion: Motion) -> bytes:
        quats = rotations.normalize(motion.rotations[:, self._joints].double())
        angles = continuous_euler(rotations.to_matrix(quats).numpy(), _ORDER, self._before)
        self._before = angles[-1].copy()
        root = motion.root.double().numpy() * _PER_METRE
        values = np.concatenate((root, angles.reshape(len(motion), -1)), axis=1)
        row = " ".join(["%.6f"] * values.shape[1]) + "\n"
        return "".join([row % tuple(frame) for frame in values.tolist()]).encode()


def continuous_euler(matrices: np.ndarray, order: str, before: np.ndarray | None = None) -> np.ndarray:
    """Intrinsic Euler angles in degrees (F, J, 3) of rotation matrices (F, J, 3, 3), each as near as possible to the
    frame before; the first to ``before`` (J, 3) if there is one.

    Every rotation has two sets of angles, (a, b, c) and (a + 180, 180 - b, c + 180), and any number of full turns.
    """
    i, j, k = ("XYZ".index(axis) for axis in order)
    sign = 1.0 if (j - i) % 3 == 1 else -1.0
    middle = np.arcsin(np.clip(sign * matrices[..., i, k], -1.0, 1.0))
    first = np.arctan2(-sign * matrices[..., j, k], matrices[..., k, k])
    # The last angle from what remains after the first: right also where the middle one locks the other two together.
    cosine, sine = np.cos(first), np.sin(first)
    last = np.arctan2(
        sign * cosine * matrices[..., j, i] + sine * matrices[..., k, i],
        cosine * matrices[..., j, j] + sign * sine * matrices[..., k, j],
    )
    angles: np.ndarray = np.degrees(np.stack((first, middle, last), axis=-1))
    other = np.stack((angles[..., 0] + 180.0, 180.0 - angles[..., 1], angles[..., 2] + 180.0), axis=-1)
    for f in range(len(angles)):
        if before is None:
            before = angles[f]
            continue
        near = angles[f] + 360.0 * np.round((before - angles[f]) / 360.0)
        far = other[f] + 360.0 * np.round((before - other[f]) / 360.0)
        turn_back = np.abs(far - before).sum(-1) < np.abs(near - before).sum(-1)
        before = angles[f] = np.where(turn_back[:, None], far, near)
    return angles


def _hierarchy_text(skeleton: Skeleton) -> tuple[list[str], list[int]]:
    """Lines of the hierarchy and the order in which it names the joints: depth first, without recursion."""
    plain = [re.sub(r"[\s{}]+", "_", name).encode("utf-8", "replace") for name in skeleton.joints]
    names = [name[:MAX_NAME].decode(errors="ignore") for name in plain]
    if len(set(names)) < len(names) or not all(names):
        raise InputError(
            f"joint names that are empty, or alike but for spaces or behind {MAX_NAME} bytes, cannot be written as "
            "BVH; rename joints"
        )
    turns = " ".join(f"{axis}rotation" for axis in _ORDER)
    offsets = (skeleton.offsets.double() * _PER_METRE).tolist()
    lines, joints = ["HIERARCHY"], []
    stack: list[tuple[int, int] | str] = [(0, 0)]
    while stack:
        item = stack.pop()
        if isinstance(item, str):
            lines.append(item)
            continue
        j, depth = item
        joints.append(j)
        pad, inside = "\t" * depth, "\t" * (depth + 1)
        channels = f"6 Xposition Yposition Zposition {turns}" if j == 0 else f"3 {turns}"
        place = [0.0, 0.0, 0.0] if j == 0 else offsets[j]
        lines += [f"{pad}{'JOINT' if j else 'ROOT'} {names[j]}", f"{pad}{{"]
        lines += [f"{inside}OFFSET {_vector(place)}", f"{inside}CHANNELS {channels}"]
        stack.append(f"{pad}}}")
        if skeleton.children[j]:
            stack += [(child, depth + 1) for child in reversed(skeleton.children[j])]
        else:
            lines += [
                f"{inside}End Site",
                f"{inside}{{",
                f"{inside}\tOFFSET {_vector(_tip(place, _PER_METRE))}",
                f"{inside}}}",
            ]
    return lines, joints


def _tip(bone: list[float], scale: float) -> list[float]:
    length = float(np.linalg.norm(bone))
    if length < 1e-6 * scale:
        return [0.0, _TIP * scale, 0.0]
    return [value / length * _TIP * scale for value in bone]


def _vector(values: list[float]) -> str:
    return " ".join(f"{value:.6f}" for value in values)


def _local(bvh: BvhFile) -> tuple[Tensor, Tensor]:
    """Rotation (F, J, 4) and position (F, J, 3) of every joint in its parent, float64."""
    values = torch.from_numpy(bvh.values)
    frames, joints = len(values), len(bvh.joints)
    quats = torch.zeros(frames, joints, 4, dtype=torch.float64)
    quats[..., 3] = 1.0
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
