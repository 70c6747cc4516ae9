"""The native npz: rotations, root path and skeleton of a motion.

F frames, J joints. A native npz holds ``rotations`` (F, J, 4) xyzw and ``root`` (F, 3) m, both float32, ``fps``,
``skeleton`` (its name), ``joints`` (J,) names, ``parents`` (J,) with -1 for the root, ``offsets`` (J, 3) m of the rest
pose, and ``metadata``, a JSON object.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch

from moveset.errors import FormatError, InputError
from moveset.io.amass import amass_motion
from moveset.io.limits import MAX_FRAMES, MAX_JOINTS, MAX_POSES, atomic_write
from moveset.io.numpy_file import Npz
from moveset.motion.clip import Motion
from moveset.motion.rigs import as_skeleton
from moveset.motion.skeleton import Skeleton


def write_npz(motion: Motion, path: str | Path, *, metadata: Mapping[str, object] | None = None) -> None:
    """Write the native npz.

    Raises:
        InputError: the path cannot be written to.
    """
    with atomic_write(path) as file:
        np.savez(
            file,
            rotations=motion.rotations.numpy().astype(np.float32),
            root=motion.root.numpy().astype(np.float32),
            **still_arrays(motion.skeleton, motion.fps, metadata or {}),
        )


def still_arrays(skeleton: Skeleton, fps: float, metadata: Mapping[str, object]) -> dict[str, Any]:
    """What a native npz holds besides rotations and root."""
    return {
        "fps": np.array(fps, dtype=np.float64),
        "skeleton": np.array(skeleton.name),
        "joints": np.array(skeleton.joints),
        "parents": np.array(skeleton.parents, dtype=np.int32),
        "offsets": skeleton.offsets.numpy().astype(np.float32),
        "metadata": np.array(json.dumps(dict(metadata))),
    }


def read_npz(path: str | Path, *, fps: float | None = None) -> Motion:
    """Read a native npz, or SMPL poses in any spelling (``io.amass``), which may lack the rate that ``fps`` gives.

    Raises:
        InputError: the file cannot be read.
        FormatError: damaged, arrays missing, of the wrong type or shape, not finite, or over the limits.
    """
    npz = Npz(path)
    return _native(npz) if "rotations" in npz.names else amass_motion(npz, fps)


def npz_metadata(path: str | Path) -> dict[str, Any]:
    """The metadata of a native npz; empty for others.

    Raises:
        InputError, FormatError: as ``read_npz``.
    """
    npz = Npz(path)
    if "metadata" not in npz.names:
        return {}
    try:
        found = json.loads(str(npz.array("metadata", "U", ())))
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{path}: its metadata is not JSON; it is damaged") from error
    return found if isinstance(found, dict) else {}


def _native(npz: Npz) -> Motion:
    turns = npz.array("rotations", "f", (None, None, 4))
    frames, joints = turns.shape[:2]
    if not 1 <= frames <= MAX_FRAMES or not 1 <= joints <= MAX_JOINTS or frames * joints > MAX_POSES:
        npz.fail(f"{frames} frames of {joints} joints are not within {MAX_FRAMES} and {MAX_JOINTS}; split the file")
    root = npz.array("root", "f", (frames, 3))
    fps = float(npz.array("fps", "fiu", ()))
    names = tuple(str(name) for name in npz.array("joints", "U", (joints,)))
    parents = tuple(int(p) for p in npz.array("parents", "iu", (joints,)))
    offsets = npz.array("offsets", "f", (joints, 3))
    norms = np.linalg.norm(turns, axis=-1)
    if np.abs(norms - 1.0).max() > 1e-2 or not 0 < fps <= 1000:
        npz.fail(f"its rotations are not unit quaternions or its frame rate {fps:g} is not in (0, 1000]; it is damaged")
    try:
        skeleton = as_skeleton(
            str(npz.array("skeleton", "U", ()))[:64], names, parents, torch.from_numpy(offsets.astype(np.float32))
        )
    except InputError as error:
        raise FormatError(f"{npz.path}: {error}") from error
    return Motion(torch.from_numpy(turns.astype(np.float32)), torch.from_numpy(root.astype(np.float32)), fps, skeleton)
