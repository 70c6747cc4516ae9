"""``moveset inspect``: what is in a motion file."""

import json as jsonlib
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    from moveset.io.contents import Contents


def inspect(
    file: Annotated[tyro.conf.Positional[Path], tyro.conf.arg(metavar="FILE")],
    *,
    source_fps: Annotated[float | None, tyro.conf.arg(metavar="N")] = None,
    animation: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None,
    json: tyro.conf.FlagCreatePairsOff[bool] = False,
) -> int:
    """Tell what is in a motion file and what `moveset convert` would make of it.

    Args:
        file: A motion file: .bvh .glb .gltf .vrma .npz .npy or .html.
        source_fps: Frame rate of the file, whatever it says of itself.
        animation: Which of a glTF file's animations, or the number of one of an array's motions.
        json: Print one JSON object on stdout and nothing else.
    """
    from moveset.io.contents import inspect as look

    found = look(file, source_fps=source_fps, animation=animation)
    print(jsonlib.dumps(asdict(found)) if json else _text(found))
    return 0


def _text(found: "Contents") -> str:
    rows = [
        ("frames", f"{found.frames} at {found.fps:g} fps, {found.seconds:.4g} s"),
        ("skeleton", f"{found.skeleton}, {len(found.joints)} joints, names: {found.family}"),
        ("unit", f"{found.unit:g} m"),
        ("axes", f"up {found.up or 'unknown'}, rest pose facing {found.facing or 'unknown'}"),
        ("stands by", found.stands or "nothing known"),
        ("height", f"{found.height:.3g} m at rest, joints only"),
        ("floor", f"lowest joint at {found.floor:+.3f} m"),
        ("travels", f"{found.travel:.3g} m over the ground"),
    ]
    if found.animations:
        rows.insert(1, ("animations", ", ".join(found.animations)))
    rows += [("made by", f"{key}: {value}") for key, value in found.metadata.items()]
    rows += [("joint", f"{role:<15} {joint}") for role, joint in found.roles.items()]
    rows += [("note", line) for line in found.warnings]
    rows += [("convert", line) for line in found.convert]
    return "\n".join([found.file, *(f"  {name:<11}{value}" for name, value in rows)])
