"""A model folder with one or more students trained anew; every other file stays as it is, to the byte."""

import argparse
import hashlib
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from safetensors.torch import save as save_safetensors

from moveset.errors import InputError, exit_code_of
from moveset.io.manifest import json_bytes, write_whole
from moveset.models.registry import describe, require_range
from moveset.pipelines.bundle import Bundle
from moveset.pipelines.model_folder import FORMAT, TEXT_TO_MOTION, ModelSpec, find_folder, task_of
from moveset.pipelines.stored_weights import MAX_ERROR, subtracted
from moveset.pipelines.stream_bundle import StreamBundle
from moveset.training import frozen
from moveset.training.pack import check_phases, student_phases
from moveset.training.pack_stream import by_network


def exchange(
    model: str | Path,
    students: Mapping[str, Path | Sequence[Path]],
    out: Path,
    guidance: Mapping[str, float] | None = None,
    tremor: Mapping[str, float] | None = None,
    averaged: bool = True,
    max_error: float = MAX_ERROR,
    **changes: Any,
) -> Path:
    """Write ``out``: the model with these students, stored as differences from what they were distilled from.

    Args:
        model: name of a shipped model, or a folder.
        students: run folder or checkpoint by name of the network ("pcm-1", "lcm-1" …), new ones too; of several the
            mean of their weights is taken, which suits runs that went on from one another (arXiv 2203.05482).
        out: the folder to write; may be the model's own.
        guidance: default guidance scale by name, where it changes.
        tremor: of a stream's student by name, instead of that of its training; guidance makes it tremble
            (``SegmentTransformerConfig``).
        averaged: the students' averaged weights instead of the last ones.
        max_error: how far 8-bit differences may be from the weights (``pipelines.stored_weights.subtracted``).
        changes: other fields of the model's configuration, such as ``symmetric`` and ``travelling``.

    Raises:
        InputError: a network that is no student, one of other sizes or phases, a new one without guidance, or guidance
            or tremor of a network that has none, or ``max_error`` above .1.
        FormatError: the model is damaged.
    """
    require_range("error of differences", max_error, 0.0, 0.1)
    folder = find_folder(model)
    is_clips = task_of(folder) == TEXT_TO_MOTION
    opened: Any = Bundle(folder) if is_clips else StreamBundle(folder)
    base = "teacher" if is_clips else "rdm"
    blobs = {name: opened.read(name) for name in opened.files}
    stored = opened.tensors(f"{base}.safetensors")
    specs, provenance = dict(opened.config.models), dict(opened.config.provenance)
    for name, given in students.items():
        phases = student_phases(name)
        loaded = frozen.load_all(given, "student_ema" if averaged else "student")
        for found in loaded:
            _check(name, found, phases, specs[base], opened.config.points)
        network = frozen.mean(name, loaded).module
        kind, settings = describe(_damped(network.config, name, tremor or {}))
        sha256 = hashlib.sha256(blobs[f"{base}.safetensors"]).hexdigest()
        specs[name] = ModelSpec(kind=kind, config=settings, base=base, base_sha256=sha256)
        provenance[name] = frozen.provenance(loaded)
        blobs[f"{name}.safetensors"] = save_safetensors(subtracted(network.state_dict(), stored, max_error))
    for what, known, numbers in (("guide", specs, guidance), ("damp", students, tremor)):
        if unknown := set(numbers or {}) - set(known):
            raise InputError(f"there is no network {sorted(unknown)[0]!r} to {what}; choose {', '.join(known)}")
    config = replace(
        opened.config,
        models=specs,
        provenance=provenance,
        guidance={**opened.config.guidance, **(guidance or {})},
        **changes,
    )
    if scaleless := [name for name in students if name not in config.guidance]:
        raise InputError(
            f"{scaleless[0]!r} is new to the model and has no guidance scale; add --guidance {scaleless[0]}=W"
        )
    blobs["config.json"] = json_bytes({"format": FORMAT, "task": config.task, **asdict(config)})
    type(config).parse(blobs["config.json"], out / "config.json")
    write_whole(out, blobs)
    return out


def _damped(config: Any, name: str, tremor: Mapping[str, float]) -> Any:
    if name not in tremor:
        return config
    if not hasattr(config, "tremor"):
        raise InputError(f"{name!r} has no tremor to damp; that is of a stream's students")
    return replace(config, tremor=tremor[name])


def _check(name: str, found: frozen.Frozen, phases: int, base: ModelSpec, points: int) -> None:
    if name.startswith("pcm"):
        check_phases(name, phases, found)
        # One phase ends at the same place on every grid.
        if phases > 1 and (learned := found.task["points"]) != points:
            raise InputError(
                f"{name!r} was distilled on a grid of {learned} points, the model has {points}; pack it anew"
            )
    for size, ours in base.config.items():
        if size in ("features", "frames", "tokens", "token_dim", "text_dim") and found.config.get(size) != ours:
            raise InputError(f"{name!r} has {size} {found.config.get(size)}, the model {ours}; they do not fit")


def main() -> None:
    """Command line: ``python -m moveset.training.exchange motionpcm-small pcm-1=runs/small/pcm-1 --out FOLDER``."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("model", help="name of a shipped model, or a folder")
    parser.add_argument(
        "students",
        nargs="+",
        metavar="NETWORK=RUN[,RUN]",
        help="run folder or checkpoint of a student; the mean of several",
    )
    parser.add_argument("--guidance", nargs="*", default=[], metavar="NETWORK=W", help="where it changes")
    parser.add_argument("--tremor", nargs="*", default=[], metavar="NETWORK=C", help="of a stream's students")
    parser.add_argument("--symmetric", nargs="*", help="of a stream: networks to be sampled with mirror images")
    parser.add_argument("--travelling", type=float, help="of a stream: how much the root of whoever goes is held")
    parser.add_argument("--name", help="what the model is called from now on")
    parser.add_argument("--last", action="store_true", help="the students' last weights instead of the averaged ones")
    parser.add_argument(
        "--max-error", type=float, default=MAX_ERROR, help="of 8-bit differences, relative; half precision beyond it"
    )
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    pairs = [pair.partition("=") for pair in given.students]
    if pathless := [name for name, _, paths in pairs if not paths]:
        raise InputError(f"{pathless[0]!r} names no run; write NETWORK=RUN, such as pcm-1=runs/small/pcm-1")
    students = {name: [Path(path) for path in paths.split(",")] for name, _, paths in pairs}
    changes: dict[str, Any] = {} if given.symmetric is None else {"symmetric": tuple(given.symmetric)}
    changes |= {name: getattr(given, name) for name in ("travelling", "name") if getattr(given, name) is not None}
    of_streams = [name for name in ("symmetric", "travelling") if name in changes]
    if of_streams and task_of(find_folder(given.model)) == TEXT_TO_MOTION:
        raise InputError(f"--{of_streams[0]} is of streams, and {given.model!r} makes clips; leave it out")
    scales, tremor = (by_network(chosen, tuple(students)) for chosen in (given.guidance, given.tremor))
    print(exchange(given.model, students, given.out, scales, tremor, not given.last, given.max_error, **changes))


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
