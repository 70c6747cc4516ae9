"""Motions in files: ``load`` and ``save`` choose the format by the file's extension.

| extension | written | read |
|---|---|---|
| .bvh | rotations, centimetres | any BVH; its unit of length is guessed from the body's size |
| .glb .gltf | skinned body with animation | animations of skins or nodes |
| .vrma | VRM animation | both |
| .npz | rotations and skeleton; ``.amass.npz``: AMASS poses | both |
| .npy | joint positions (F, J, 3) | positions, and features of HumanML3D and KIT-ML |
| .html | a page that plays it, offline and by itself | its first motion |
| .mp4 .gif .png | video, animation, filmstrip | no |

Metadata is kept inside .glb, .gltf and .vrma (``asset.extras.moveset``), .npz and .html (``metadata``), .png (text
chunk "moveset"), .gif and .mp4 (comment). BVH, AMASS npz and npy have no place for it: there it goes into a file
beside, ``walk.bvh.json``.
"""

import json
import os
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from moveset.errors import FormatError, InputError

if TYPE_CHECKING:
    from moveset.motion.clip import Motion

#: What a file is told to remember of how its motion was made: prompt, seed, model, …
Metadata = Mapping[str, str | int | float | None]


@dataclass(frozen=True)
class Body:
    """What is known of the body in a file; what is None is guessed.

    Args:
        unit: metres per unit of length of the file.
        up: axis that points up in it ("x", "y", "z", "-x", …).
        facing: axis along which its rest pose looks; the motion is turned so that this becomes +Z.
        joints: role -> name of the joint that plays it, "" for none; others are recognised.
    """

    unit: float | None = None
    up: str | None = None
    facing: str | None = None
    joints: Mapping[str, str] = field(default_factory=dict)


#: Where what writes a file, or reads what it remembers, is in this package; nothing is imported before it is asked for.
_WRITERS = {
    ".bvh": "bvh.write_bvh", ".glb": "gltf.write_glb", ".gltf": "gltf.write_gltf", ".vrma": "gltf.write_vrma",
    ".html": "html.save_html", ".npz": "arrays.write_npz", ".amass.npz": "amass.write_amass",
    ".npy": "joint_arrays.write_npy", ".png": "filmstrip.write_filmstrip", ".gif": "video.write_gif",
    ".mp4": "video.write_mp4",
}  # fmt: skip
_REMEMBERED = {
    **dict.fromkeys((".glb", ".gltf", ".vrma"), "gltf_reader.glb_metadata"), ".npz": "arrays.npz_metadata",
    ".html": "html.html_metadata", ".png": "filmstrip.filmstrip_metadata",
}  # fmt: skip
GLTF = (".gltf", ".vrma", ".glb")
READABLE = (".gltf", ".vrma", ".bvh", ".glb", ".npz", ".npy", ".html")
_PICTURES = (".mp4", ".gif", ".png")
WRITABLE = (*READABLE, *_PICTURES)
_BODIES = (".bvh", *GLTF)  # may have any axes, any unit and any names
_DRAWN = (*GLTF, ".html", *_PICTURES)  # with a body hung on the rest pose
_OF_BLENDER = (".fbx", ".dae", ".usd", ".usda", ".usdc", ".usdz", ".blend", ".abc")
_THROUGH_BLENDER = (
    ": open it in Blender and export it as glTF 2.0 (.glb) or BVH",
    ": write a .glb or .bvh, import that into Blender and export it from there",
)
_PICKLES = (".pkl", ".pickle", ".pt", ".pth", ".joblib")
_PICKLE = ": a pickle could run anything and is never read; save its joint positions (frames, 22, 3) by numpy.save"
_USUAL = (5.0, 480.0)  # frames a second of motion that is meant to be seen
_LONGEST = 255  # bytes of a file's name, on the file systems in use


def load(
    path: str | Path,
    *,
    fps: float | None = None,
    source_fps: float | None = None,
    animation: str | None = None,
    body: Body | None = None,
    as_stored: bool = False,
) -> "Motion":
    """Read a motion, Y up and facing +Z at rest.

    Args:
        path: the file; its extension says how it is read.
        fps: rate at which curves are sampled (glTF); other files keep the rate of their frames.
        source_fps: frames per second of the file, whatever it says.
        animation: name of one of a glTF file's animations, or number of one of an array's motions.
        body: what is known of the body in a .bvh or glTF file, where it should not be guessed.
        as_stored: leave the body standing as it does in the file, whatever its axes.

    Raises:
        InputError: an unknown extension, a rate that is not in 0.01 to 1000, or a file that cannot be read.
        FormatError: a file that is damaged, absurd or not what its extension says.
    """
    motion = _loaded(path, fps, source_fps, animation, body)
    if as_stored:
        return motion
    if (suffix := Path(path).suffix.lower()) in _BODIES:
        placed = _placed(motion, body or Body(), in_metres=suffix == ".bvh")
        # Our own glTF files are as they are meant to be; a BVH file that once was ours has been through other hands.
        ours = suffix in GLTF and body is None and placed is not motion and read_metadata(path)
        motion = motion if ours else placed
    if len(motion) > 1 and not _USUAL[0] <= motion.fps <= _USUAL[1]:
        meant = f", {1000 * motion.fps:.4g} for milliseconds" if _USUAL[0] <= 1000 * motion.fps <= _USUAL[1] else ""
        warnings.warn(
            f"{path}: {motion.fps:.3g} frames a second are unusual; if they are not meant, give --source-fps{meant}",
            stacklevel=2,
        )
    return motion


def _loaded(
    path: str | Path, fps: float | None, source_fps: float | None, animation: str | None, body: Body | None
) -> "Motion":
    suffix = _suffix(path, READABLE, "read")
    if animation is not None and suffix not in (*GLTF, ".npy"):
        raise InputError(f"{path}: {suffix} files hold one motion; leave --animation out")
    for what, rate in (("a motion", fps), ("a source", source_fps)):
        if rate is not None and not 0.01 <= rate <= 1000:
            raise InputError(f"{what} of {rate:g} frames a second is not in 0.01 to 1000; give one such as 30")
    if body is not None and suffix not in _BODIES:
        raise InputError(f"{path}: unit, axes and joints of {suffix} files are known; leave what says them out")
    if suffix == ".bvh":
        motion = _load_bvh(path, source_fps, body)
    elif suffix in GLTF:
        from moveset.io.gltf_reader import read_glb

        # Frames that are to be called another rate's are those that the file has.
        motion = read_glb(path, fps=fps if source_fps is None else None, animation=animation)
    elif suffix == ".html":
        from moveset.io.html import read_html

        motion = read_html(path)
    elif suffix == ".npz":
        from moveset.io.arrays import read_npz

        motion = read_npz(path, fps=source_fps)
    else:
        from moveset.io.joint_arrays import read_npy

        motion = read_npy(path, fps=source_fps, sample=animation, notes=_notes_beside(Path(path)))
    return motion if source_fps is None else replace(motion, fps=source_fps)


def save(motion: "Motion", path: str | Path, *, metadata: Metadata | None = None) -> Path:
    """Write a motion, whole or not at all.

    Args:
        motion: what to write.
        path: where to; the extension says how.
        metadata: what to remember with it (prompt, seed, model, …); ``prompt`` is also the caption of pictures.

    Raises:
        InputError: an unknown extension, a name too long, more frames than ``load`` takes, or a path that cannot be
            written to.
    """
    suffix, path = _suffix(path, WRITABLE, "write"), Path(path)
    check_name(path)
    _check_length(motion, path, suffix)
    motion, notes = motion.detached(), dict(metadata or {})
    if suffix in _DRAWN:
        from moveset.motion.reference import resting_upright

        motion = resting_upright(motion)
    write = _function(_WRITERS[".amass.npz" if _is_amass(path) else suffix])
    if suffix in _PICTURES:
        write(motion, path, caption=str(notes.get("prompt") or ""), metadata=json.dumps(notes) if notes else "")
    elif _has_beside(path):
        write(motion, path)
    else:
        write(motion, path, metadata=notes)
    if suffix == ".npy":
        from moveset.io.joint_arrays import still_notes

        notes |= still_notes(motion)
    save_beside(notes, path)
    return path


def _check_length(motion: "Motion", path: Path, suffix: str) -> None:
    """Refuse a motion that could not be read from its file again."""
    from moveset.io.limits import MAX_FRAMES, MAX_POSES

    frames, joints = len(motion), len(motion.skeleton)
    # Others keep positions, or the joints of another skeleton.
    whole = suffix in (".bvh", ".npz", ".glb", ".gltf") and not _is_amass(path)
    if suffix in READABLE and (frames > MAX_FRAMES or (whole and frames * joints > MAX_POSES)):
        raise InputError(
            f"{frames} frames of {joints} joints exceed what is read back ({MAX_FRAMES} frames, {MAX_POSES} poses); "
            "write shorter pieces"
        )


def rate_of(fps: float, path: str | Path) -> float:
    """Frames a second of the file in which a motion of ``fps`` is written: films do not have every rate."""
    suffix = _suffix(path, WRITABLE, "write")
    if suffix not in (".gif", ".mp4"):
        return fps
    from moveset.io.video import film_rate

    return film_rate(fps, suffix)


def save_beside(metadata: Metadata, path: Path) -> None:
    """Write metadata into the file beside a motion, where its format has no place for it.

    Raises:
        InputError: the folder cannot be written to.
    """
    from moveset.io.limits import atomic_write

    # Where there are none, those of another motion that was here before must not be taken for its own.
    if not _has_beside(path) or not (metadata or _beside(path).exists()):
        return
    with atomic_write(_beside(path)) as file:
        # Halves of letters, as a GLB or a command line may bring them, have no UTF-8; JSON spells them as escapes.
        file.write((json.dumps(metadata, ensure_ascii=False, indent=1) + "\n").encode("utf-8", "backslashreplace"))


def read_metadata(path: str | Path) -> dict[str, Any]:
    """What ``save`` was told to remember in glTF, .npz, .html or .png, or beside a .bvh, .npy or AMASS npz.

    {} if nothing.

    Raises:
        InputError: an extension without metadata that can be read, or a file that cannot be read.
        FormatError: a damaged file.
    """
    suffix = _suffix(path, (*READABLE, ".png"), "read metadata of")
    if suffix in _REMEMBERED and not _is_amass(path):
        found: dict[str, Any] = _function(_REMEMBERED[suffix])(path)
        return found
    return _notes_beside(Path(path))


def _notes_beside(path: Path) -> dict[str, Any]:
    from moveset.io.limits import read_limited

    beside = _beside(path)
    if not os.path.exists(beside):  # nor can there be one of a name too long, of which Path.exists complains
        return {}
    try:
        found = json.loads(read_limited(beside, 2**20))
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{beside} is not JSON; delete it or write the motion again") from error
    return found if isinstance(found, dict) else {}


def _function(place: str) -> Callable[..., Any]:
    module, name = place.split(".")
    found: Callable[..., Any] = getattr(import_module(f"moveset.io.{module}"), name)
    return found


def _suffix(path: str | Path, known: tuple[str, ...], verb: str) -> str:
    suffix = Path(path).suffix.lower()
    if suffix not in known:
        way = _THROUGH_BLENDER[verb == "write"] if suffix in _OF_BLENDER else _PICKLE if suffix in _PICKLES else ""
        raise InputError(
            f"cannot {verb} {str(path)!r}: its extension is not one of {' '.join(known)}; use one of these{way}"
        )
    return suffix


def _is_amass(path: str | Path) -> bool:
    return Path(path).name.lower().endswith(".amass.npz")


def check_name(path: Path) -> None:
    """Refuse a name that the file system has no room for, together with that of the notes beside it.

    Raises:
        InputError: it is too long.
    """
    for name in (*path.parts, _beside(path).name if _has_beside(path) else ""):
        if len(os.fsencode(name)) > _LONGEST:
            raise InputError(f"the name {name!r} is longer than {_LONGEST} bytes; give a shorter one")


def _has_beside(path: Path) -> bool:
    return path.suffix.lower() in (".bvh", ".npy") or _is_amass(path)


def _beside(path: Path) -> Path:
    return path.with_name(path.name + ".json")


def _placed(motion: "Motion", body: Body, *, in_metres: bool) -> "Motion":
    """In metres, Y up, with the joints as they were named."""
    from moveset.motion.reference import upright
    from moveset.motion.rigs import with_roles
    from moveset.motion.units import resized, unit_of

    if body.joints:
        motion = replace(motion, skeleton=with_roles(motion.skeleton, body.joints))
    if not in_metres and (unit := body.unit or unit_of(motion)) != 1.0:
        motion = resized(motion, unit)
    return upright(motion, up=body.up, facing=body.facing)


def _load_bvh(path: str | Path, fps: float | None, body: Body | None) -> "Motion":
    from moveset.io.bvh import bvh_motion, likely_scale
    from moveset.io.bvh_parser import read_bvh
    from moveset.motion.rigs import as_skeleton, name_after

    bvh = read_bvh(path, fps=fps)
    motion = bvh_motion(bvh, scale=(body.unit if body else None) or likely_scale(bvh))
    found, name = motion.skeleton, name_after(Path(path))
    return replace(motion, skeleton=as_skeleton(name, found.joints, found.parents, found.offsets))
