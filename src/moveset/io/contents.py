"""What is in a motion file, and what is made of it: the answer to why it comes out wrong."""

import warnings
from dataclasses import dataclass
from pathlib import Path

import torch

from moveset.errors import InputError
from moveset.motion import rotations
from moveset.motion.clip import Motion

_FLOOR = 0.01  # share of frames in which the lowest joint may be lower


@dataclass(frozen=True)
class Contents:
    """A motion file as it is read.

    Args:
        frames, fps, seconds: of the animation that is read.
        animations: names of all, where the format has several.
        skeleton: what it is called; joints are those that are kept.
        family: whose names these are.
        roles: role -> name of the joint that plays it; empty where no legs are recognised.
        unit: metres per unit of length of the file.
        up, facing: axes of the file that point up, and along which its rest pose looks ("y", "-z", …); None where
            that cannot be told.
        stands: by what it is known how the body stands ("rest pose", "T-pose", "derived"); None where it is not.
        height: of the skeleton at rest, from its lowest to its highest joint, metres.
        floor: height of the lowest joint over the floor, but for 1 % of the frames, metres.
        travel: way of the root over the ground from the first frame to the last, metres.
        metadata: what the file remembers of how it was made.
        warnings: what had to be guessed or passed over.
        convert: what ``moveset convert`` would do, as sentences.
    """

    file: str
    format: str
    frames: int
    fps: float
    seconds: float
    animations: tuple[str, ...]
    skeleton: str
    joints: tuple[str, ...]
    family: str
    roles: dict[str, str]
    unit: float
    up: str | None
    facing: str | None
    stands: str | None
    height: float
    floor: float
    travel: float
    metadata: dict[str, object]
    warnings: tuple[str, ...]
    convert: tuple[str, ...]


def inspect(path: str | Path, *, source_fps: float | None = None, animation: str | None = None) -> Contents:
    """Look into a motion file.

    Args:
        source_fps, animation: as for ``moveset.io.load``.

    Raises:
        InputError, FormatError: the file cannot be read.
    """
    from moveset.io import load, read_metadata
    from moveset.motion.reference import find_reference
    from moveset.motion.rigs import recognised

    path = Path(path)
    with warnings.catch_warnings(record=True) as heard:
        warnings.simplefilter("always")
        plain = load(path, source_fps=source_fps, animation=animation, as_stored=True)
        motion = load(path, source_fps=source_fps, animation=animation)
        try:
            found, reference = recognised(plain.skeleton), find_reference(plain)
            unknown = ""
        except InputError as error:
            found, reference, unknown = None, None, str(error)
    said = tuple(dict.fromkeys(str(warning.message) for warning in heard))
    rest = motion.skeleton.rest_positions[:, 1]
    lowest = motion.joints[..., 1].amin(dim=1)
    unit = _unit(path, plain, motion)
    up = _axis(rotations.inv(reference.up), "y") if reference else None
    facing = _axis(rotations.inv(reference.turns[0]), "z") if reference and reference.how == "rest pose" else None
    return Contents(
        file=str(path),
        format=path.suffix.lower(),
        frames=len(motion),
        fps=motion.fps,
        seconds=motion.seconds,
        animations=_animations(path),
        skeleton=motion.skeleton.name,
        joints=motion.skeleton.joints,
        family=found.family if found else "unknown",
        roles={role: plain.skeleton.joints[j] for role, j in found.roles.items()} if found else {},
        unit=unit,
        up=up,
        facing=facing,
        stands=reference.how if reference else None,
        height=float(rest.max() - rest.min()),
        floor=float(lowest.double().quantile(_FLOOR)),
        travel=float((motion.root[-1] - motion.root[0])[[0, 2]].norm()),
        metadata=read_metadata(path),
        warnings=said,
        convert=_plan(motion, unit, up, facing, unknown),
    )


def _animations(path: Path) -> tuple[str, ...]:
    from moveset.io import GLTF

    if path.suffix.lower() not in GLTF:
        return ()
    from moveset.io.glb import Glb
    from moveset.io.gltf_clip import animation_names

    return tuple(animation_names(Glb(path)))


def _unit(path: Path, plain: Motion, motion: Motion) -> float:
    """Metres per unit of length of the file."""
    if path.suffix.lower() == ".bvh":
        from moveset.io.bvh import likely_scale
        from moveset.io.bvh_parser import read_bvh

        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return float(f"{likely_scale(read_bvh(path, fps=plain.fps)):.4g}")
    before, after = (float(m.skeleton.offsets.norm(dim=-1).sum()) for m in (plain, motion))
    return float(f"{after / before:.4g}") if before > 0.0 else 1.0


def _axis(turn: torch.Tensor, name: str) -> str:
    """The axis nearest to where a rotation (4,) takes an axis."""
    direction = rotations.rotate(turn.double(), torch.eye(3, dtype=torch.float64)["xyz".index(name)])
    nearest = int(direction.abs().argmax())
    return ("-" if direction[nearest] < 0 else "") + "xyz"[nearest]


def _plan(motion: Motion, unit: float, up: str | None, facing: str | None, unknown: str) -> tuple[str, ...]:
    plan = [f"read {len(motion)} frames at {motion.fps:g} fps on {len(motion.skeleton)} joints"]
    if unit != 1.0:
        plan.append(f"multiply lengths by {unit:g} to have metres (--scale says another unit)")
    if up not in (None, "y"):
        plan.append(f"turn {up} up to y up (--up says another axis)")
    if facing not in (None, "z"):
        plan.append(f"turn the rest pose from facing {facing} to facing z (--facing says another axis)")
    if unknown:
        plan.append(f"keep the skeleton; --skeleton fails: {unknown}")
    else:
        plan.append("with --skeleton, retarget by the roles of the joints (--map FILE.json says others)")
    return tuple(plan)
