"""CMU Graphics Lab Motion Capture Database: ASF/AMC takes, and BVH conversions where there is no AMC.

A conversion has a T-pose in front and begins one frame of the capture late; some keep every fifth frame of it only,
with two decimals, and turn single joints by half a turn for some frames.
"""

import math
import re
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from moveset.data import glitches
from moveset.data.hml22_calibration import FPS, assemble, turn
from moveset.data.listing import read_listing
from moveset.data.resample import resampled
from moveset.data.takes import ImportedRun, ImportedTake, RejectedTake, TakeRef
from moveset.errors import InputError
from moveset.io.asf_amc import read_amc, read_asf
from moveset.io.bvh import local_frames
from moveset.io.bvh_parser import read_bvh
from moveset.motion import rotations
from moveset.motion.kinematics import fk
from moveset.motion.skeleton import HML22
from moveset.motion.smoothing import spans

_SIDES = (("left", "l", 1.0), ("right", "r", -1.0))
_BVH_METRES = 0.01
# At full rate the blend out of the T-pose, and the ringing after, last until frame 7.
_BVH_LEADING = 8
# Pitch of ankle to toe of somebody standing flat, and in the zero pose of every ASF, degrees.
_STANCE_PITCH = -18.0
_ZERO_POSE_PITCH = -11.2
_DUPLICATES = {"14_36": "it is the same motion as 14_31"}
#: 60_NN and 61_NN are the two partners of one dance.
_SALSA = re.compile(r"6[01]_(\d\d)")


def list_takes(root: Path) -> list[TakeRef]:
    """Trials of ``root/trials.jsonl``, one reference each: AMC wherever there is one, since it keeps the subject's size
    and wrists and has no flips.

    Raises:
        InputError: there is no trial list.
        FormatError: it is not UTF-8, or a line of it is damaged.
    """
    listing = Path(root) / "trials.jsonl"
    if not listing.is_file():
        raise InputError(f"{listing} is missing; give the folder that holds trials.jsonl and subjects/")
    return read_listing(listing, lambda number, trial: _listed(Path(root), trial), "a trial")


def _listed(root: Path, trial: dict[str, Any]) -> TakeRef:
    """A line's trial."""
    name, files, fps = str(trial["trial"]), [str(file) for file in trial["files"]], float(trial["fps"])
    if not files or not fps > 0:
        raise ValueError(f"{len(files)} files at {fps:g} frames a second")
    path = root / next((file for file in files if file.endswith(".amc")), files[0])
    capture_hz, subject, amc = float(trial.get("capture_hz", fps)), name.split("_")[0], path.suffix == ".amc"
    return TakeRef(
        name=name,
        source="cmu-amc" if amc else "cmu-bvh" if fps == capture_hz else "cmu-more",
        path=path,
        subject=subject,
        group=str(trial.get("group", _SALSA.sub(r"60-61_\1", name))),
        description=str(trial["description"]),
        fps=fps,
        capture_hz=capture_hz,
        drop=0 if amc else int(trial.get("drop_first", _BVH_LEADING)),
        skeleton=path.with_name(f"{subject}.asf") if amc else None,
        leave_out=_DUPLICATES.get(name, ""),
        levelled=True,
    )


def read_take(ref: TakeRef) -> ImportedTake:
    """The clean runs of a trial on ``hml22`` at 20 fps, neither levelled nor on the floor yet.

    Raises:
        RejectedTake: the trial should not be trained on, or has no clean run of 24 frames.
        InputError: a file cannot be read.
        FormatError: a file is damaged.
    """
    if ref.leave_out:
        raise RejectedTake(f"{ref.name}: {ref.leave_out}")
    runs, total, longest = [], 0, 0
    for first, local, root in read_whole(ref):
        local = glitches.faced_elbows(local)
        turned, joints = fk(local, root, HML22)
        bad = glitches.glitch_mask(local, root, joints, FPS)
        bad |= glitches.turned_head(turned) | glitches.impossible_foot(local)
        total += len(root)
        for start, stop in spans(~bad):
            longest = max(longest, stop - start)
            if stop - start >= glitches.MIN_FRAMES:
                calm = glitches.calm_wrists(local[start:stop])
                runs.append(ImportedRun(first + start, calm, root[start:stop]))
    if not runs:
        raise RejectedTake(f"{ref.name}: its longest run without glitches has {longest} of {total} frames")
    kept = sum(map(len, runs))
    return ImportedTake(tuple(runs), "" if kept == total else f"{total - kept} of {total} frames have glitches")


def read_whole(ref: TakeRef) -> list[tuple[int, Tensor, Tensor]]:
    """A whole trial at 20 fps in the capture's own place, split where the whole body jumps, flips mended.

    Returns:
        For each piece its first frame, counted from the beginning of the capture, local rotations (F, 22, 4) and root
        (F, 3).
    """
    local, root = _from_bvh(ref) if ref.skeleton is None else _from_amc(ref, ref.skeleton)
    if len(root) < ref.drop + 4:
        raise RejectedTake(f"{ref.name}: only {len(root)} frames")
    # Frame k of a conversion is k - 1 of the capture, at the capture's rate.
    late = 0.0 if ref.skeleton is not None else 1.0 / ref.capture_hz
    times = torch.arange(len(root), dtype=torch.float64) / ref.fps - late
    stride = ref.fps / FPS
    pieces = []
    if stride == int(stride):
        first = math.ceil(float(times[ref.drop]) * FPS - 1e-6)
        taken = slice(round((first / FPS + late) * ref.fps), None, int(stride))
        local, root = local[taken], root[taken]
        for start, stop in glitches.whole_body_jumps(root, FPS):
            piece = rotations.unroll(local[start:stop])
            pieces.append((first + start, glitches.mended(piece, FPS), root[start:stop]))
        return pieces
    local, root, times = local[ref.drop :], root[ref.drop :], times[ref.drop :]
    for start, stop in glitches.whole_body_jumps(root, ref.fps):
        if stop - start < 4:
            continue
        piece, place, time = glitches.mended(local[start:stop], ref.fps), root[start:stop], times[start:stop]
        frames = torch.arange(math.ceil(float(time[0]) * FPS - 1e-6), math.floor(float(time[-1]) * FPS + 1e-6) + 1)
        if len(frames):
            pieces.append((int(frames[0]), *resampled(piece, place, time, frames / FPS)))
    return pieces


def _from_amc(ref: TakeRef, skeleton: Path) -> tuple[Tensor, Tensor]:
    asf = read_asf(skeleton)
    take = read_amc(ref.path, asf)
    turned, ends = take.world
    where = {bone: j for j, bone in enumerate(asf.bones)}
    source = {"pelvis": "root", "spine2": "upperback", "spine3": "thorax", "head": "head"}
    constant: dict[str, Tensor] = {}
    flat = turn("x", _STANCE_PITCH - _ZERO_POSE_PITCH)
    for side, s, _ in _SIDES:
        source |= {
            f"{side}_collar": s + "clavicle", f"{side}_shoulder": s + "humerus", f"{side}_elbow": s + "wrist",
            f"{side}_wrist": s + "hand", f"{side}_hip": s + "femur", f"{side}_knee": s + "tibia",
            f"{side}_ankle": s + "foot", f"{side}_foot": s + "toes",
        }  # fmt: skip
        thigh = asf.vectors[where[s + "femur"]]
        splay = rotations.between(thigh.new_tensor((0.0, -1.0, 0.0)), thigh)
        constant |= {f"{side}_hip": splay, f"{side}_knee": splay, f"{side}_shoulder": turn("x", -30.0)}
        constant |= {f"{side}_{part}": rotations.mul(splay, flat) for part in ("ankle", "foot")}
    ours = {joint: turned[:, where[bone]] for joint, bone in source.items()}
    hips = ends[:, [where["lhipjoint"], where["rhipjoint"]]].mean(dim=1)
    leg = sum(asf.length(bone) for bone in ("lfemur", "ltibia", "rfemur", "rtibia")) / 2
    return assemble(_calibrated(ours, constant), hips, leg)


def _from_bvh(ref: TakeRef) -> tuple[Tensor, Tensor]:
    frames = local_frames(read_bvh(ref.path), root="hip")
    turned, placed = frames.world()
    where = {name: j for j, name in enumerate(frames.joints)}
    source = {"pelvis": "hip", "spine2": "abdomen", "spine3": "chest", "head": "head"}
    constant = {"head": turn("x", 16.2)}
    for side, s, out in _SIDES:
        source |= {
            f"{side}_collar": s + "Collar", f"{side}_shoulder": s + "Shldr", f"{side}_elbow": s + "Hand",
            f"{side}_wrist": s + "Hand", f"{side}_hip": s + "Thigh", f"{side}_knee": s + "Shin",
            f"{side}_ankle": s + "Foot", f"{side}_foot": s + "Foot",
        }  # fmt: skip
        sag = turn("z", -8.7 if out > 0 else 8.5)
        constant |= {f"{side}_hip": turn("x", 5.0), f"{side}_knee": turn("x", 5.0), f"{side}_ankle": turn("x", -2.6)}
        constant |= {f"{side}_foot": turn("x", -2.6), f"{side}_elbow": sag, f"{side}_wrist": sag}
        constant[f"{side}_shoulder"] = rotations.mul(sag, turn("x", -30.0))
    ours = {joint: turned[:, where[bone]] for joint, bone in source.items()}
    hips = placed[:, [where["lThigh"], where["rThigh"]]].mean(dim=1) * _BVH_METRES
    bones = ("lShin", "lFoot", "rShin", "rFoot")
    leg = sum(float(frames.offsets[where[bone]].norm()) for bone in bones) / 2 * _BVH_METRES
    return assemble(_calibrated(ours, constant), hips, leg)


def _calibrated(ours: dict[str, Tensor], constant: dict[str, Tensor]) -> dict[str, Tensor]:
    return {joint: rotations.mul(q, constant[joint]) if joint in constant else q for joint, q in ours.items()}
