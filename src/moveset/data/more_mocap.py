"""Eleven small sets of motion capture as BVH, each on skeletons of its own, with a sentence for every take."""

import json
import math
import re
import warnings
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from moveset.data import glitches
from moveset.data.hml22_calibration import FPS
from moveset.data.listing import read_listing
from moveset.data.resample import resampled
from moveset.data.takes import ImportedRun, ImportedTake, RejectedTake, TakeRef
from moveset.errors import InputError
from moveset.io.bvh import bvh_motion
from moveset.io.bvh_parser import read_bvh
from moveset.motion.retarget import retarget
from moveset.motion.skeleton import HML22
from moveset.motion.smoothing import spans

#: Names by which takes of CMU and of Bandai-Namco are known, which are read and told in other ways.
_TAKEN = re.compile(r"cmu([\d-]|$)|bandai")


def list_takes(root: Path) -> list[TakeRef]:
    """Takes of ``root/takes.jsonl``; empty lines count for nothing.

    Raises:
        InputError: there is no list.
        FormatError: it is not UTF-8, or a line of it is damaged, or has the name of another one's take.
    """
    listing = Path(root) / "takes.jsonl"
    if not listing.is_file():
        raise InputError(f"{listing} is missing; give the folder that holds takes.jsonl and takes/")
    lines: dict[str, int] = {}

    def once(number: int, take: dict[str, Any]) -> TakeRef:
        ref = _listed(Path(root), take)
        if (first := lines.setdefault(ref.name, number)) != number:
            raise ValueError(f"its name {ref.name!r} is that of line {first}, too")
        return ref

    return read_listing(listing, once, "a take")


def _listed(root: Path, take: dict[str, Any]) -> TakeRef:
    """A line's take."""
    for key in ("take", "source", "file"):
        if not isinstance(take[key], str):
            raise ValueError(f"its {key} is {json.dumps(take[key])}, not text")
    if not isinstance(take["sentence"], str | None):
        raise ValueError(f"its sentence is {json.dumps(take['sentence'])}, neither text nor null")
    if not 0 < (unit := float(take["unit_m"])) < math.inf:
        raise ValueError(f"a unit of {unit:g} metres")
    if _TAKEN.match(take["source"]):
        raise ValueError(f"its source {take['source']!r} begins like those of other sets, cmu and bandai")
    return TakeRef(
        name=take["take"],
        source=take["source"],
        path=root / take["file"],
        subject=take["take"],  # nobody says who else is the same performer, or on the same floor
        group=take["take"],
        sentence=" ".join((take["sentence"] or "").split()) or None,
        unit=unit,
        leave_out="its joints jump" if take.get("quality") == "spikes" else "",
    )


def read_take(ref: TakeRef) -> ImportedTake:
    """A take on ``hml22`` at 20 fps, not on the floor yet, without the poses for calibration at its ends.

    Raises:
        RejectedTake: the take should not be trained on, is nothing but such poses, or is of no humanoid.
        InputError: the file cannot be read.
        FormatError: it is damaged.
    """
    if ref.leave_out:
        raise RejectedTake(f"{ref.name}: {ref.leave_out}")
    bvh = read_bvh(ref.path)
    with warnings.catch_warnings():
        # These skeletons have no telling rest pose; how they stand is found from the motion.
        warnings.simplefilter("ignore", UserWarning)
        try:
            motion = retarget(bvh_motion(bvh, scale=ref.unit), HML22)
        except InputError as error:
            raise RejectedTake(f"{ref.name}: {error}") from error
    local, root = motion.rotations.double(), motion.root.double()
    if len(root) < 4:
        raise RejectedTake(f"{ref.name}: only {len(root)} frames")
    start, stop = without_calibration(motion.joints, bvh.fps)
    first = int(start / bvh.fps * FPS) + 1 if start else 0
    frames = torch.arange(first, max(first, int((stop - 1) / bvh.fps * FPS + 1e-6) + 1))
    if stop - start < 4 or not len(frames):
        raise RejectedTake(f"{ref.name}: nothing but poses for calibration")
    times = torch.arange(start, stop, dtype=torch.float64) / bvh.fps
    local, root = resampled(glitches.mended(local[start:stop], bvh.fps), root[start:stop], times, frames / FPS)
    return ImportedTake((ImportedRun(first, local, root),))


def without_calibration(joints: Tensor, fps: float) -> tuple[int, int]:
    """First and one-past-last frame of a take (F, J, 3) on ``hml22`` without a T- or A-pose at either end.

    Such a pose holds both straight arms out symmetrically and still, or far out to the sides; the way out of it, up to
    half a second, goes with it.
    """
    side = {}
    for name in ("left", "right"):
        shoulder, elbow, wrist = (joints[:, HML22.index(f"{name}_{part}")] for part in ("shoulder", "elbow", "wrist"))
        upper, fore = elbow - shoulder, wrist - elbow
        straight = torch.cosine_similarity(upper, fore, dim=-1) > 0.94
        reach = (wrist - shoulder) / (wrist - shoulder).norm(dim=-1, keepdim=True).clamp_min(1e-6)
        side[name] = (straight, reach)
    across = joints[:, HML22.index("left_shoulder")] - joints[:, HML22.index("right_shoulder")]
    across = across / across.norm(dim=-1, keepdim=True).clamp_min(1e-6)
    out_left = (side["left"][1] * across).sum(dim=-1)
    out_right = -(side["right"][1] * across).sum(dim=-1)
    down = -0.5 * (side["left"][1][:, 1] + side["right"][1][:, 1])
    held = side["left"][0] & side["right"][0] & (out_left > 0.55) & (out_right > 0.55)
    held &= ((out_left - out_right).abs() < 0.15) & (down > -0.2)
    speed = joints.diff(dim=0).norm(dim=-1).amax(dim=1) * fps
    held &= torch.cat((speed, speed[-1:])) < 0.6
    # Arms far out to both sides are one even where somebody still sways, or a recording breaks off on the way there;
    # but not of who balances, or flies.
    wide = (out_left > 0.75) & (out_right > 0.75) & (down > -0.5)
    if wide.float().mean() < 0.5:
        held |= wide
    found = spans(held)
    start, stop, out = 0, len(joints), round(0.5 * fps)
    if found and found[0][0] <= out // 4:
        start = min(found[0][1] + out, len(joints))
    if found and found[-1][1] >= len(joints) - out // 4 and found[-1][0] >= start:
        stop = max(found[-1][0] - out, start)
    return start, stop
