"""SMPL poses in npz files, as AMASS spells them and those who followed. F frames.

| spelling | root | body | path | rate |
|---|---|---|---|---|
| AMASS (SMPL-H) | ``poses`` (F, 156), also (F, J, 3) | same | ``trans`` | ``mocap_framerate`` |
| AMASS (SMPL-X), Kimodo, GMR | ``root_orient`` (F, 3) | ``pose_body`` (F, 63) | ``trans`` | ``mocap_frame_rate`` |
| the smplx library | ``global_orient`` | ``body_pose`` (F, 63 or 69) | ``transl`` | ``fps`` |

Angles are axis times radians, lengths metres, Z up. The body is hml22's whatever the shape parameters.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import torch

from moveset.io.limits import MAX_FRAMES, atomic_write
from moveset.io.numpy_file import Npz
from moveset.motion import rotations
from moveset.motion.clip import Motion
from moveset.motion.retarget import retarget
from moveset.motion.skeleton import HML22, Skeleton

# Where SMPL's pelvis lies in its template, metres, rounded from the mean shape: AMASS translates the template, so the
# pelvis of a frame is at trans + this, whatever the pose.
_SMPL_PELVIS = (0.0, -0.22, 0.03)
# Z up, as AMASS has it, to Y up.
_Z_TO_Y = rotations.about("x", -90.0)
_PARTS = (("root_orient", "pose_body"), ("global_orient", "body_pose"))
_PATHS = ("trans", "transl")
_RATES = ("mocap_framerate", "mocap_frame_rate", "fps")
_UPRIGHT = 0.7  # cosine
_FLOOR = 0.06  # metres


def write_amass(motion: Motion, path: str | Path) -> None:
    """Write an npz as AMASS has them, in both spellings: Z up, ``poses`` (F, 156) and their parts, ``trans``, zero
    ``betas`` and hands.

    SMPL's own joint positions are licensed, so a body of these poses is not exactly this one: hml22's rest pose stands
    in for SMPL's, which differs from it by some degrees in the spine, collars and feet.

    Raises:
        InputError: the path cannot be written to, or the skeleton cannot be retargeted to SMPL's joints.
    """
    motion = retarget(_body(motion), HML22)
    up = rotations.inv(_Z_TO_Y).to(motion.rotations)  # pieces of a stream are float64
    local = motion.rotations[:, :22].clone()
    local[:, 0] = rotations.mul(up, local[:, 0])
    poses = np.zeros((len(motion), 156), dtype=np.float64)
    poses[:, :66] = rotations.to_rotvec(local).reshape(len(motion), 66).numpy()
    with atomic_write(path) as file:
        np.savez(
            file,
            poses=poses,
            root_orient=poses[:, :3],
            pose_body=poses[:, 3:66],
            pose_hand=poses[:, 66:],
            trans=(rotations.rotate(up, motion.root).double() - torch.tensor(_SMPL_PELVIS)).numpy(),
            betas=np.zeros(16),
            gender=np.array("neutral"),
            mocap_framerate=np.float64(motion.fps),
            mocap_frame_rate=np.float64(motion.fps),
        )


def amass_motion(npz: Npz, fps: float | None = None) -> Motion:
    """The motion of a file of SMPL poses; ``fps`` is its rate, whatever it says.

    Raises:
        FormatError: no poses in a known spelling, of another shape, or no rate.
    """
    poses = _poses(npz)
    frames = len(poses)
    place = next((name for name in _PATHS if name in npz.names), _PATHS[0])
    trans = torch.from_numpy(npz.array(place, "f", (frames, 3)).astype(np.float64))
    if fps is None:
        rate = next((name for name in _RATES if name in npz.names), "")
        if not rate:
            npz.fail("it has no 'mocap_framerate'; give the frame rate by --source-fps")
        # Some tools store the one number as an array of one.
        said = npz.array(rate, "fiu", None)
        fps = float(said.reshape(-1)[0]) if said.size == 1 else 0.0
    if not 0 < fps <= 1000:
        npz.fail(f"{fps:g} frames per second are not in (0, 1000]; give the true rate by --source-fps")
    local = rotations.from_rotvec(torch.from_numpy(poses))
    root = trans + torch.tensor(_SMPL_PELVIS)
    turn = (rotations.identity() if _along_y(Motion(local, root, fps, HML22)) else _Z_TO_Y).double()
    local[:, 0] = rotations.mul(turn, local[:, 0])
    root = rotations.rotate(turn, root)
    return Motion(rotations.unroll(rotations.normalize(local)).float(), root.float(), fps, HML22)


def _along_y(motion: Motion) -> bool:
    """Whether bodies stand along Y, as in the same arrays by video trackers, and not along Z.

    Who crawls or lies with the head towards Y in a world with Z up does not: there the lowest joint keeps to height
    zero along Z, as on a floor, with the pelvis above it, and not along Y.
    """
    up = rotations.rotate(motion.rotations[:, 0], torch.tensor((0.0, 1.0, 0.0), dtype=torch.float64)).mean(dim=0)
    if not (up[1] > _UPRIGHT and up[1] > up[2]):
        return False
    lowest = motion.joints.amin(dim=1)
    on_floor = (lowest.abs() < _FLOOR).double().mean(dim=0)
    above = float((motion.root[:, 2] - lowest[:, 2]).median())
    return not (on_floor[2] > 0.5 > on_floor[1] and float(motion.root[:, 2].median()) > _FLOOR < above)


def _body(motion: Motion) -> Motion:
    """Without what SMPL's bodies have behind hml22's joints, which then may be one body."""
    count, skeleton = len(HML22), motion.skeleton
    if skeleton.joints[:count] != HML22.joints or len(skeleton) == count:
        return motion
    body = Skeleton(skeleton.name, skeleton.joints[:count], skeleton.parents[:count], skeleton.offsets[:count])
    return replace(motion, rotations=motion.rotations[:, :count], skeleton=body)


def _poses(npz: Npz) -> np.ndarray:
    """(F, 22, 3) rotation vectors of root and body."""
    parts = next((names for names in _PARTS if set(names) <= npz.names.keys()), None)
    if parts is not None and "poses" not in npz.names:
        flat = [npz.array(name, "f", None) for name in parts]
        flat = [values.reshape(len(values), -1) if values.ndim > 1 else values for values in flat]
        if any(values.ndim != 2 for values in flat) or len(flat[0]) != len(flat[1]) or flat[0].shape[1] != 3:
            npz.fail(f"{parts[0]!r} and {parts[1]!r} are not (frames, 3) and (frames, 63); give SMPL poses")
        poses = np.concatenate(flat, axis=1)
    elif "poses" in npz.names:
        poses = npz.array("poses", "f", None)
        if poses.ndim == 3 and poses.shape[2] == 3:
            poses = poses.reshape(len(poses), -1)
    else:
        npz.fail(
            "it has neither 'rotations' (moveset) nor 'poses', or 'root_orient' and 'pose_body' (AMASS); give one of "
            "these kinds of npz"
        )
    if poses.ndim != 2 or not 1 <= len(poses) <= MAX_FRAMES or poses.shape[1] < 66 or poses.shape[1] % 3:
        npz.fail(
            f"poses of shape {poses.shape} are not 1 to {MAX_FRAMES} frames of at least 66 angles; give SMPL poses"
        )
    values: np.ndarray = poses[:, :66].astype(np.float64).reshape(len(poses), 22, 3)
    return values
