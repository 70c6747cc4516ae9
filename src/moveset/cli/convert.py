"""``moveset convert``: one motion file to another format, skeleton or frame rate."""

from pathlib import Path
from typing import Annotated, Any

import tyro

from moveset.errors import FormatError


def convert(
    source: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="IN")],
    target: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="OUT")],
    *,
    skeleton: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None,
    fps: Annotated[float | None, tyro.conf.arg(metavar="N")] = None,
    source_fps: Annotated[float | None, tyro.conf.arg(metavar="N")] = None,
    animation: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None,
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
        in_place: Without travel over the ground.
        loop: Blend the end into the beginning.
    """
    from moveset.cli.output import Finish, plan_outputs, write
    from moveset.io import load
    from moveset.io.take_writer import recover_take

    finish = Finish.check(fps=fps, skeleton=skeleton, in_place=in_place, loop=loop)
    [paths] = plan_outputs([target], [""])
    if source.suffix == ".part":
        frames = recover_take(source)
        source = source.with_suffix("")
        print(f"{source}: {frames} frames rescued")
    motion = load(source, fps=fps, source_fps=source_fps, animation=animation)
    motion, _ = write(motion, paths, finish, _notes(source))
    print(f"{target}: {len(motion)} frames at {motion.fps:g} fps on {motion.skeleton.name}")
    return 0


def _notes(source: Path) -> dict[str, Any]:
    """What the file remembers of how its motion was made."""
    from moveset.io import read_metadata

    try:
        found = read_metadata(source)
    except FormatError:  # a motion that can be read is worth converting without them
        return {}
    # What a GLB says of its frames is not what the new file has.
    return {key: value for key, value in found.items() if key not in ("fps", "skeleton")}
