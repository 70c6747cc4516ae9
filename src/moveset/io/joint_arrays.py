"""Arrays of joint positions, and of the features that data sets make of them, in .npy files; shapes tell the axes.

F frames, J joints, N samples, D = 263 (HumanML3D) or 251 (KIT-ML) features.

| shape | whose |
|---|---|
| (F, J, 3) | HumanML3D's ``new_joints``, MoMask, MotionLCM, ``write_npy`` |
| (J, 3, F), (N, J, 3, F) | MDM |
| (N, F, J, 3) | batches |
| (F, D), (N, F, D), (N, D, 1, F) | features as in ``new_joint_vecs``; batches of them, MDM's |

J is 22 (HumanML3D), 21 (KIT-ML), 24 or 52 (SMPL, SMPL-H), or that of a built-in skeleton.
"""

import warnings
from collections.abc import Mapping
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from moveset.errors import FormatError
from moveset.io.limits import MAX_FRAMES, atomic_write, read_limited
from moveset.io.numpy_file import PICKLED, parse_array
from moveset.motion.clip import Motion
from moveset.motion.features import get_codec
from moveset.motion.hml import HmlCodec
from moveset.motion.positions import HINGES, solve_rotations
from moveset.motion.rigs import RIGS, roles
from moveset.motion.skeleton import HML22, Skeleton

PLAIN_FPS = 20.0  # of an array that nothing is known of: HumanML3D's
_CODECS = {263: "hml", 251: "kit"}
_JOINTS = {52, *map(len, RIGS.values())}
_UNITS = (1.0, 0.01, 0.001)
_REACH = 2.0  # metres along the bones from hand to foot of a grown body
_SWAY = 0.03  # of a bone's length: more says that joints are in another order
_NO_SIZE = 1e-6  # metres


def write_npy(motion: Motion, path: str | Path) -> None:
    """Write joint positions (F, J, 3) float32, metres; with hml22 they are HumanML3D's ``new_joints``.

    Raises:
        InputError: the path cannot be written to.
    """
    with atomic_write(path) as file:
        np.save(file, motion.joints.numpy().astype(np.float32))


def read_npy(
    path: str | Path, *, fps: float | None = None, sample: str | None = None, notes: Mapping[str, Any] | None = None
) -> Motion:
    """Read joint positions or features, and find rotations for them (``motion.positions``).

    Args:
        fps: frames per second; without it what ``notes`` say, else the data set's own.
        sample: number of the motion in an array of several, from 1.
        notes: what is known of the array: ``fps``, and ``skeleton``, the name of a built-in one.

    Raises:
        InputError: the file cannot be read.
        FormatError: damaged, of another shape or type, not finite, a pickle, or over the limits.
    """
    data = read_limited(path)
    if data[:1] == b"\x80":
        raise FormatError(f"{path}: {PICKLED}")
    values = parse_array(BytesIO(data), len(data), str(path), "fiu")
    one = _frames_first(str(path), values, sample)
    if not 1 <= len(one) <= MAX_FRAMES:
        raise FormatError(f"{path}: {len(one)} frames are not in 1 to {MAX_FRAMES}; split the array")
    known = notes or {}
    said = known.get("fps")
    if fps is None and isinstance(said, int | float) and 0.01 <= said <= 1000:
        fps = float(said)
    if one.ndim == 2:
        return _decoded(str(path), one, fps)
    return _solved(str(path), one, fps or PLAIN_FPS, known.get("skeleton"))


def _frames_first(path: str, values: np.ndarray, sample: str | None) -> np.ndarray:
    """(F, J, 3) or (F, D) of one motion."""
    shape = values.shape
    # The axes behind that of several motions, if there is one, tell whose they are.
    several = len(shape) == 4 or (len(shape) == 3 and shape[2] in _CODECS)
    one = shape[1:] if several else shape
    order: tuple[int, ...] = ()
    if len(one) == 3 and one[1] in _JOINTS and one[2] == 3:
        order = (0, 1, 2)
    elif len(one) == 3 and ((one[0] in _JOINTS and one[1] == 3) or (one[0] in _CODECS and one[1] == 1)):
        order = (2, 0, 1)
    elif len(one) == 2 and one[1] in _CODECS:
        order = (0, 1)
    if not order:
        raise FormatError(
            f"{path}: its shape {shape} is none of (frames, 22, 3), (22, 3, frames), (samples, 22, 3, frames) or "
            "(frames, 263), nor KIT-ML's with 21 and 251; give joint positions or features in one of these orders"
        )
    if several:
        values = values[_which(path, len(values), sample)]
    elif sample is not None:
        raise FormatError(f"{path}: there is no motion {sample!r} in an array of one; leave --animation out")
    values = values.transpose(order)
    return values[..., 0] if values.shape[2:] == (1,) else values


def _which(path: str, count: int, sample: str | None) -> int:
    """Index of the wanted motion of several."""
    if sample is None:
        if count > 1:
            said = f"it holds {count} motions, of which the first is read; --animation 2 reads another"
            warnings.warn(f"{path}: {said}", stacklevel=2)
        sample = "1"
    if not sample.isdecimal() or len(sample) > 9 or not 1 <= int(sample) <= count:
        raise FormatError(f"{path}: there is no motion {sample!r}; give a number from 1 to {count} by --animation")
    return int(sample) - 1


def _decoded(path: str, features: np.ndarray, fps: float | None) -> Motion:
    codec = get_codec(_CODECS[features.shape[1]])
    assert isinstance(codec, HmlCodec)
    height = float(np.median(features[:, 3])) * codec.convention.unit
    contacts = features[:, -4:]
    if not 0.05 < height < 3.0 or contacts.min() < -0.5 or contacts.max() > 1.5:
        raise FormatError(
            f"{path}: these features have roots at {height:.3g} m; where they are normalised, multiply them by Std.npy "
            "and add Mean.npy of their data set first"
        )
    joints = codec.joints(torch.from_numpy(features.astype(np.float64))) * codec.reflection
    return solve_rotations(joints.float(), fps or codec.fps, codec.skeleton)


def _solved(path: str, values: np.ndarray, fps: float, name: object) -> Motion:
    joints = torch.from_numpy(values.astype(np.float64))
    skeleton = _skeleton_of(joints, name)
    joints = joints[:, : len(skeleton)]
    lengths = _lengths(joints, skeleton).mean(dim=0)
    reach = float(lengths.topk(8).values.sum())
    if reach < _NO_SIZE:
        raise FormatError(f"{path}: all joints lie in one place, so there is no body; save the array again")
    joints = joints * min(_UNITS, key=lambda unit: abs(np.log(reach * unit / _REACH)))
    if skeleton.name not in HINGES:
        # Joints of hml22 by their roles; what else a rig has is at rest between them.
        found = roles(skeleton)
        joints, skeleton = joints[:, [found[role] for role in HML22.joints]], HML22
    return solve_rotations((joints * _reflection(joints, skeleton)).float(), fps, skeleton)


def _skeleton_of(joints: Tensor, name: object) -> Skeleton:
    """Whose joints in whose order these are: the named skeleton, else the one whose bones keep their lengths."""
    count = joints.shape[1]
    if isinstance(name, str) and name in RIGS and len(RIGS[name]) == count:
        return RIGS[name]
    fitting = [rig for rig in RIGS.values() if len(rig) == count] or [HML22]  # SMPL-H's first 22 are hml22's
    sways = []
    for rig in fitting:
        lengths = _lengths(joints[:, : len(rig)], rig)
        sways.append(float((lengths.std(dim=0, correction=0) / lengths.mean(dim=0).clamp_min(1e-9)).mean()))
    best = min(range(len(fitting)), key=sways.__getitem__)
    return fitting[best if sways[0] > _SWAY and sways[best] < 0.3 * sways[0] else 0]


def _lengths(joints: Tensor, skeleton: Skeleton) -> Tensor:
    """(F, J - 1) lengths of the bones."""
    return (joints[:, 1:] - joints[:, list(skeleton.parents[1:])]).norm(dim=-1)


def _reflection(joints: Tensor, skeleton: Skeleton) -> Tensor:
    """(3,) -1 for x where the joints are a body's mirror image, as KIT-ML's are: left is not where toes tell."""
    left_heel, left_toe, right_heel, right_toe = (joints[:, j] for j in skeleton.feet)
    hip = {side: joints[:, skeleton.index(f"{side}_hip")] for side in ("left", "right")}
    across = hip["left"] - hip["right"]
    ahead = left_toe - left_heel + right_toe - right_heel
    # With Y up, left × up is ahead: (x, ·, z) × (0, 1, 0) = (-z, ·, x).
    facing = float((ahead[:, 2] * across[:, 0] - ahead[:, 0] * across[:, 2]).mean())
    return joints.new_tensor((-1.0 if facing < 0.0 and skeleton.name == "kit21" else 1.0, 1.0, 1.0))


def still_notes(motion: Motion) -> dict[str, str | float]:
    """What an array of positions does not say of a motion, where it is not what is taken for granted."""
    if motion.fps == PLAIN_FPS and motion.skeleton is HML22:
        return {}
    return {"fps": motion.fps, "skeleton": motion.skeleton.name}
