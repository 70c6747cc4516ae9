"""CMU Graphics Lab Motion Capture Database: ASF/AMC takes, and BVH conversions where there is no AMC."""

import json
from dataclasses import replace
from pathlib import Path

from torch import Tensor

from moveset.data import glitches
from moveset.data.hml22_calibration import FPS, assemble, chain, finish, turn
from moveset.data.takes import ImportedTake, RejectedTake, TakeRef, imported
from moveset.errors import FormatError, InputError
from moveset.io.asf_amc import read_amc, read_asf
from moveset.io.bvh import local_frames, read_bvh
from moveset.motion import rotations
from moveset.motion.kinematics import fk
from moveset.motion.skeleton import HML22

_SIDES = (("left", "l", 1.0), ("right", "r", -1.0))
_BVH_METRES = 0.01
# The conversions start in a T-pose; the blend out of it, and the ringing after, last until frame 7.
_BVH_LEADING = 8
# Marker placement of each subject, degrees of forward pitch to take away.
_PELVIS_PITCH = {"39": 15.0, "05": 8.0, "49": 8.0, "07": 5.0, "60": 5.0, "61": 5.0, "08": 4.0, "03": 4.0, "35": -4.0}
_HEAD_PITCH = {
    "03": 30.0, "05": 35.0, "10": 25.0, "09": 21.0, "60": 16.0, "61": 16.0, "38": 15.0, "16": 12.0, "32": 14.0,
    "49": 13.0, "13": 11.0, "14": 11.0, "35": 9.0, "01": 8.0, "07": 8.0, "12": 8.0, "135": 7.0,
}  # fmt: skip
_HEAD_PITCH_DEFAULT = 6.0
# Pitch of ankle to toe of a subject standing flat, and in the zero pose of every ASF, degrees.
_STANCE_PITCH = {"55": -7.3, "10": -20.9}
_STANCE_PITCH_DEFAULT = -18.0
_ZERO_POSE_PITCH = -11.2
_DUPLICATES = {"14_36": "it is the same motion as 14_31"}
# Words of descriptions that name something the body stands on, hangs from or sits on, which the data do not hold.
_APPARATUS = ("climb", "ladder", "stool", "uneven", "steps")


def list_takes(root: Path) -> list[TakeRef]:
    """Trials of ``root/trials.jsonl``, one reference each: AMC wherever there is one, since it keeps the subject's size
    and wrists and has no flips.

    Raises:
        InputError: there is no trial list.
        FormatError: a line of it is damaged.
    """
    listing = Path(root) / "trials.jsonl"
    if not listing.is_file():
        raise InputError(f"{listing} is missing; give the folder that holds trials.jsonl and subjects/")
    takes: list[TakeRef] = []
    for number, line in enumerate(listing.read_text(encoding="utf-8").splitlines(), start=1):
        try:
            trial = json.loads(line)
            name, files, description = str(trial["trial"]), list(trial["files"]), str(trial["description"])
            fps, sentences = int(trial["fps"]), tuple(str(text) for text in trial["kit_captions"])
            file = next((str(file) for file in files if str(file).endswith(".amc")), str(files[0]))
        except (ValueError, KeyError, TypeError, IndexError) as error:
            raise FormatError(f"{listing}, line {number}: not a trial ({error}); restore the original file") from error
        amc = file.endswith(".amc")
        subject = name.split("_")[0]
        takes.append(
            TakeRef(
                name=name,
                source="cmu-amc" if amc else "cmu-bvh",
                path=Path(root) / file,
                content=description.split(" - ")[0],
                style=None,
                description=description,
                sentences=sentences,
                # The partners of the salsa dances move as one, so nothing may separate them.
                subject="60-61" if subject in ("60", "61") else subject,
                fps=fps,
                skeleton=(Path(root) / file).with_name(f"{subject}.asf") if amc else None,
                leave_out=_leave_out(name, description),
            )
        )
    return takes


def _leave_out(name: str, description: str) -> str:
    if name in _DUPLICATES:
        return _DUPLICATES[name]
    words = [word for word in _APPARATUS if word in description]
    return f"it needs support that the data do not hold ({words[0]})" if words else ""


def read_take(ref: TakeRef) -> ImportedTake:
    """The longest clean run of a trial on ``hml22`` at 20 fps.

    Raises:
        RejectedTake: the trial should not be trained on, is broken, or has no clean run of 40 frames.
        InputError: a file cannot be read.
        FormatError: a file is damaged.
    """
    if ref.leave_out:
        raise RejectedTake(f"{ref.name}: {ref.leave_out}")
    local, root = read_whole(ref)
    start, stop = clean_run(ref, local, root)
    local = glitches.calm_wrists(local[start:stop])
    return imported(ref, finish(local, root[start:stop]), (start, stop))


def read_whole(ref: TakeRef, *, start: int | None = None) -> tuple[Tensor, Tensor]:
    """A whole trial: local rotations (F, 22, 4) and root (F, 3) in the capture's own place, 20 fps, nothing cut.

    ``start`` is the first frame of the file to take; without it the conversions' T-pose is skipped.
    """
    stride, rest = divmod(ref.fps, int(FPS))
    if rest or stride < 1:
        raise InputError(f"{ref.name} has {ref.fps} frames per second, not a multiple of {FPS:g}; correct trials.jsonl")
    subject = ref.name.split("_")[0]
    if ref.skeleton is None:
        return _from_bvh(ref, subject, slice(_BVH_LEADING if start is None else start, None, stride))
    return _from_amc(ref, ref.skeleton, subject, slice(start or 0, None, stride))


def clean_run(ref: TakeRef, local: Tensor, root: Tensor) -> tuple[int, int]:
    """First and one-past-last frame of the longest run without glitches.

    Raises:
        RejectedTake: there is none of 40 frames, an elbow bends backwards, or the head is turned round.
    """
    turned, joints = fk(local, root, HML22)
    bad = glitches.glitch_mask(local, root, joints, FPS)
    bad |= glitches.turned_head(turned) | glitches.impossible_posture(local)
    start, stop = glitches.longest_clean_run(bad)
    if stop - start < min(glitches.MIN_FRAMES, len(root)):
        raise RejectedTake(f"{ref.name}: its longest run without glitches has {stop - start} of {len(root)} frames")
    share = glitches.backward_elbow(local[start:stop])
    if share > 0.1:
        raise RejectedTake(f"{ref.name}: an elbow bends backwards in {share:.0%} of the frames")
    return start, stop


def _from_amc(ref: TakeRef, skeleton: Path, subject: str, frames: slice) -> tuple[Tensor, Tensor]:
    asf = read_asf(skeleton)
    take = read_amc(ref.path, asf)[frames]
    turned, ends = take.world
    where = {bone: j for j, bone in enumerate(asf.bones)}
    source = {"pelvis": "root", "spine2": "upperback", "spine3": "thorax", "head": "head"}
    constant: dict[str, Tensor] = {}
    flat = turn("x", _STANCE_PITCH.get(subject, _STANCE_PITCH_DEFAULT) - _ZERO_POSE_PITCH)
    for side, s, _ in _SIDES:
        source |= {
            f"{side}_collar": s + "clavicle", f"{side}_shoulder": s + "humerus", f"{side}_elbow": s + "wrist",
            f"{side}_wrist": s + "hand", f"{side}_hip": s + "femur", f"{side}_knee": s + "tibia",
            f"{side}_ankle": s + "foot", f"{side}_foot": s + "toes",
        }  # fmt: skip
        thigh = asf.vectors[where[s + "femur"]]
        splay = rotations.between(thigh.new_tensor((0.0, -1.0, 0.0)), thigh)
        constant |= {f"{side}_hip": splay, f"{side}_knee": splay, f"{side}_shoulder": turn("x", -30.0)}
        constant |= {f"{side}_ankle": chain(splay, flat), f"{side}_foot": chain(splay, flat)}
    ours = {joint: turned[:, where[bone]] for joint, bone in source.items()}
    hips = ends[:, [where["lhipjoint"], where["rhipjoint"]]].mean(dim=1)
    leg = sum(asf.length(bone) for bone in ("lfemur", "ltibia", "rfemur", "rtibia")) / 2
    return assemble(_calibrated(ours, constant, subject), hips, leg)


def _from_bvh(ref: TakeRef, subject: str, taken: slice) -> tuple[Tensor, Tensor]:
    frames = local_frames(read_bvh(ref.path), root="hip")
    frames = replace(frames, rotations=frames.rotations[taken], root=frames.root[taken])
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
        constant[f"{side}_shoulder"] = chain(sag, turn("x", -30.0))
    ours = {joint: turned[:, where[bone]] for joint, bone in source.items()}
    hips = placed[:, [where["lThigh"], where["rThigh"]]].mean(dim=1) * _BVH_METRES
    bones = ("lShin", "lFoot", "rShin", "rFoot")
    leg = sum(float(frames.offsets[where[bone]].norm()) for bone in bones) / 2 * _BVH_METRES
    return assemble(_calibrated(ours, constant, subject), hips, leg)


def _calibrated(ours: dict[str, Tensor], constant: dict[str, Tensor], subject: str) -> dict[str, Tensor]:
    out = {joint: rotations.mul(q, constant[joint]) if joint in constant else q for joint, q in ours.items()}
    out["pelvis"] = rotations.mul(out["pelvis"], turn("x", -_PELVIS_PITCH.get(subject, 0.0)))
    out["head"] = rotations.mul(out["head"], turn("x", -_HEAD_PITCH.get(subject, _HEAD_PITCH_DEFAULT)))
    return out
