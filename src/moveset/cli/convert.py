"""``moveset convert``: one motion file to another format, skeleton or frame rate."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from moveset.errors import FormatError, InputError

if TYPE_CHECKING:
    from moveset.io import Body


def convert(
    source: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="IN")],
    target: Annotated[tyro.conf.Positional[Path | None], tyro.conf.arg(metavar="OUT")] = None,
    *,
    skeleton: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None,
    fps: Annotated[float | None, tyro.conf.arg(metavar="N")] = None,
    source_fps: Annotated[float | None, tyro.conf.arg(metavar="N")] = None,
    animation: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None,
    scale: Annotated[float | None, tyro.conf.arg(metavar="N")] = None,
    up: Literal["x", "y", "z", "-x", "-y", "-z"] | None = None,
    facing: Literal["x", "y", "z", "-x", "-y", "-z"] | None = None,
    joint_map: Annotated[Path | None, tyro.conf.arg(name="map", metavar="FILE")] = None,
    show_map: tyro.conf.FlagCreatePairsOff[bool] = False,
    in_place: tyro.conf.FlagCreatePairsOff[bool] = False,
    loop: tyro.conf.FlagCreatePairsOff[bool] = False,
) -> int:
    """Convert a motion file, or rescue a take whose process was killed: `moveset convert walk.bvh.part rescued.glb`.

    Args:
        source: A motion file: .bvh .glb .gltf .vrma .npz .npy or .html; or the .part of a take, which is finished
            beside it first.
        target: File to write: .bvh .glb .gltf .vrma .npz .amass.npz .npy .html .mp4 .gif or .png.
        skeleton: Retarget to smpl, mixamo, vrm, ue5, hml22 or kit21.
        fps: Frame rate of the new file.
        source_fps: Frame rate of the source, whatever it says of itself.
        animation: Which of a glTF file's animations, or the number of one of an array's motions.
        scale: Metres per unit of length of a .bvh or .glb source; guessed from the size of the body.
        up: Axis that points up in the source; found by how the body stands.
        facing: Axis along which the source's rest pose looks, which is turned to +Z; found by left and right hips.
        joint_map: JSON file that says which joint plays which part, such as {"left_hip": "Thigh_L"}; others are
            recognised.
        show_map: Print which joints are recognised as what, and why. No OUT is needed then.
        in_place: Without travel over the ground.
        loop: Blend the end into the beginning.
    """
    from moveset.cli.joint_map import joint_map_text
    from moveset.cli.output import Postprocess, plan_outputs, write
    from moveset.io import load
    from moveset.io.take_writer import recover_take

    if target is None and not show_map:
        raise InputError("there is no OUT to write to; name a file, such as walk.glb")
    finish = Postprocess(fps=fps, skeleton=skeleton, in_place=in_place, loop=loop)
    [paths] = plan_outputs([target] if target else [], [""])
    if source.suffix == ".part":
        frames = recover_take(source)
        source = source.with_suffix("")
        print(f"{source}: {frames} frames rescued")
    motion = load(source, fps=fps, source_fps=source_fps, animation=animation, body=_body(scale, up, facing, joint_map))
    if show_map:
        print(joint_map_text(motion))
    if target is None:
        return 0
    motion, _ = write(motion, paths, finish, _notes(source))
    print(f"{target}: {len(motion)} frames at {motion.fps:g} fps on {motion.skeleton.name}")
    return 0


def _body(scale: float | None, up: str | None, facing: str | None, joint_map: Path | None) -> "Body | None":
    """What is said of the body in the source; None for nothing."""
    from moveset.cli.joint_map import read_joint_map
    from moveset.io import Body

    if scale is not None and not 1e-6 <= scale <= 1e6:
        raise InputError(f"{scale:g} metres per unit of length are not in 0.000001 to 1000000; give one such as 0.01")
    if scale is None and up is None and facing is None and joint_map is None:
        return None
    return Body(scale, up, facing, {} if joint_map is None else read_joint_map(joint_map))


def _notes(source: Path) -> dict[str, Any]:
    """What the file remembers of how its motion was made."""
    from moveset.io import read_metadata

    try:
        found = read_metadata(source)
    except FormatError:  # a motion that can be read is worth converting without them
        return {}
    # What a GLB says of its frames is not what the new file has.
    return {key: value for key, value in found.items() if key not in ("fps", "skeleton")}
