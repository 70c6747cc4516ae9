"""Bandai-Namco-Research-Motiondataset 1 and 2: BVH at 30 fps in centimetres, content and style in the file's name."""

from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from moveset.data.bandai_captions import SAME_STYLE
from moveset.data.hml22_calibration import FPS, assemble, turn
from moveset.data.resample import resampled
from moveset.data.takes import ImportedRun, ImportedTake, TakeRef
from moveset.errors import FormatError, InputError
from moveset.io.bvh import local_frames
from moveset.io.bvh_parser import read_bvh
from moveset.motion import rotations
from moveset.motion.skeleton import HML22

_METRES = 0.01
_X, _Y, _Z = torch.eye(3, dtype=torch.float64)


def _undo(x: Tensor, y: Tensor) -> Tensor:
    """Inverse of the source joint's frame in hml22's rest pose, given where its local x and y axes point there."""
    frame = torch.stack((x, y, torch.linalg.cross(x, y)), dim=-1)
    return rotations.inv(rotations.from_matrix(frame))


def _constants() -> dict[str, tuple[str, Tensor]]:
    """hml22 joint -> (source joint, constant A)."""
    toe = HML22.offsets[HML22.index("left_foot")].double()
    toe = toe / toe.norm()
    table: dict[str, tuple[str, Tensor, Tensor, Tensor | None]] = {
        "pelvis": ("Hips", _Y, -_X, turn("x", 3.0)),
        "spine2": ("Spine", _Y, _Z, None),
        "spine3": ("Chest", _Y, _Z, None),
        "neck": ("Neck", _Y, _Z, turn("x", -3.0)),
        "head": ("Head", _Y, _Z, turn("x", -8.0)),
    }
    for side, end, sign, sag in (("left", "L", 1.0, -18.0), ("right", "R", -1.0, 17.0)):
        table |= {
            f"{side}_collar": (f"Shoulder_{end}", _X, sign * _Y, turn("y", sag)),
            f"{side}_shoulder": (f"UpperArm_{end}", _X, sign * _Y, None),
            f"{side}_elbow": (f"LowerArm_{end}", _X, sign * _Y, None),
            f"{side}_wrist": (f"Hand_{end}", _X, sign * _Y, None),
            f"{side}_hip": (f"UpperLeg_{end}", -sign * _Y, _X, None),
            f"{side}_knee": (f"LowerLeg_{end}", -sign * _Y, _X, None),
            f"{side}_ankle": (f"Foot_{end}", sign * toe, _X, turn("x", -13.5)),
            f"{side}_foot": (f"Toes_{end}", sign * _Z, _X, turn("x", -23.0)),
        }
    return {
        joint: (source, _undo(x, y) if extra is None else rotations.mul(_undo(x, y), extra))
        for joint, (source, x, y, extra) in table.items()
    }


_CONSTANTS = _constants()


def list_takes(root: Path) -> list[TakeRef]:
    """Takes below ``root``, which holds ``dataset-1`` and/or ``dataset-2``, in the order of their names.

    Raises:
        InputError: there are none.
    """
    takes: list[TakeRef] = []
    for path in sorted(Path(root).glob("dataset-[12]/data/*.bvh")):
        parts = path.stem.split("_")
        if len(parts) != 4:
            raise InputError(f"{path} is not named dataset-K_CONTENT_STYLE_NNN.bvh; restore its original name")
        source = "bandai" + parts[0][-1]
        style = SAME_STYLE.get(parts[2], parts[2])
        takes.append(TakeRef(path.stem, source, path, source, path.stem, content=parts[1], style=style))
    if not takes:
        raise InputError(f"{root} holds no dataset-1/data/*.bvh or dataset-2/data/*.bvh; give the unpacked data set")
    return takes


def read_take(ref: TakeRef) -> ImportedTake:
    """A take on ``hml22`` at 20 fps, not on the floor yet.

    Raises:
        InputError: the file cannot be read.
        FormatError: it is damaged or not a take of this data set.
    """
    bvh = read_bvh(ref.path)
    missing = [source for source, _ in _CONSTANTS.values() if source not in bvh.joints]
    if missing:
        raise FormatError(f"{ref.path} has no joint {missing[0]!r}; it is not a take of the Bandai-Namco data set")
    # The motion of the root sits in Hips, in a few loops also in joint_Root: both are composed.
    frames = local_frames(bvh, root="Hips")
    if len(frames.root) > 1 and bvh.fps != FPS:
        times = torch.arange(len(frames.root), dtype=torch.float64) / bvh.fps
        at = torch.arange(int(times[-1] * FPS + 1e-6) + 1) / FPS
        turned, root = resampled(frames.rotations, frames.root, times, at.double())
        frames = replace(frames, rotations=turned, root=root)
    turned, placed = frames.world()
    where = {name: j for j, name in enumerate(frames.joints)}
    ours = {
        joint: rotations.mul(turned[:, where[source]], constant) for joint, (source, constant) in _CONSTANTS.items()
    }
    hips = placed[:, [where["UpperLeg_L"], where["UpperLeg_R"]]].mean(dim=1) * _METRES
    bones = ("LowerLeg_L", "Foot_L", "LowerLeg_R", "Foot_R")
    leg = sum(float(frames.offsets[where[bone]].norm()) for bone in bones) / 2 * _METRES
    local, root = assemble(ours, hips, leg)
    return ImportedTake((ImportedRun(0, local, root),))
