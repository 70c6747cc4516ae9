"""Motions as answers: JSON with packets, or a file in memory."""

import base64
import json
import re
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from moveset.errors import InputError
from moveset.io import save
from moveset.io.packets import pack_packet, skeleton_json
from moveset.motion.clip import Motion
from moveset.motion.contacts import stances
from moveset.pipelines.postprocess import Postprocess
from moveset.server.jobs import Answer, Job
from moveset.server.limits import Limits

JSON = "application/json"
SEED, WARNINGS = "X-Moveset-Seed", "X-Moveset-Warnings"
_HEADER = 4096  # bytes of a header: clients refuse long ones, and there may be a warning for each of many prompts
PICTURES = ("mp4", "gif", "png")
_TYPES = {
    "bvh": "text/plain; charset=utf-8",
    "glb": "model/gltf-binary",
    "gltf": "model/gltf+json",
    "vrma": "model/gltf-binary",
    "npz": "application/octet-stream",
    "amass.npz": "application/octet-stream",
    "html": "text/html; charset=utf-8",
    "mp4": "video/mp4",
    "gif": "image/gif",
    "png": "image/png",
}
FORMATS, FILES = tuple(_TYPES), tuple(dict.fromkeys(_TYPES.values()))  # of files, and their content types


def check_format(name: str) -> None:
    """Refuse a format that cannot be written.

    Raises:
        InputError: an unknown one.
    """
    if name not in FORMATS:
        raise InputError(f"unknown format {name!r}; choose one of {', '.join(FORMATS)}")


def check_length(seconds: float, fps: float, format: str, limits: Limits) -> None:
    """Refuse what would take very long to write.

    Raises:
        InputError: too many seconds or frames.
    """
    if format in PICTURES and seconds > limits.picture_seconds:
        raise InputError(
            f"{seconds:.1f} s are more than the limit of {limits.picture_seconds:g} s for {format}; export a part of it"
        )
    if seconds * fps > limits.frames:
        raise InputError(
            f"{seconds:.1f} s at {fps:g} fps are more than the limit of {limits.frames:,} frames; lower the frame rate"
        )


def write_file(motion: Motion, format: str, finish: Postprocess, metadata: Mapping[str, str | int | float]) -> Answer:
    """A motion, finished, as the bytes of a file. Its name is made here, not by the client.

    Raises:
        InputError: a motion that cannot be finished like this.
    """
    name = f"{_slug(str(metadata.get('prompt') or 'motion'))}.{format}"
    with tempfile.TemporaryDirectory(prefix="moveset-") as folder:
        path = Path(folder) / f"motion.{format}"
        save(finish(motion), path, metadata=metadata)
        return Answer(path.read_bytes(), _TYPES[format], name)


def answer(job: Job) -> Answer:
    """What a finished job is answered with.

    Raises:
        InputError: a motion that cannot be finished as it was asked for.
    """
    order, first = job.order, job.made[0]
    if order.format != "json":
        return replace(write_file(first.motion, order.format, order.finish, first.metadata), headers=_headers(first))
    timings = {stage: round(sum(made.timings_ms[stage] for made in job.made), 3) for stage in first.timings_ms}
    body = {
        "model": first.model,
        "prompts": list(first.prompts),
        "seed": first.seed,
        "steps": first.steps,
        "guidance": first.guidance,
        "network_evaluations": first.network_evaluations,
        "timings_ms": timings,
        "warnings": list(first.warnings),
        "skeleton": skeleton_json(first.motion.skeleton),
        "takes": [_take(made, order.finish) for made in job.made],
    }
    return Answer(json.dumps(body).encode(), JSON)


def _headers(made: Any) -> dict[str, str]:
    """What JSON would say beside a clip: the seed it was made from, and warnings as a JSON list in ASCII."""
    told: list[str] = []
    for warning in made.warnings:
        if len(json.dumps([*told, warning])) > _HEADER:
            break
        told.append(warning)
    return {SEED: str(made.seed), WARNINGS: json.dumps(told)}


def _take(made: Any, finish: Postprocess) -> dict[str, Any]:
    motion = finish(made.motion)
    # One frame has no speed, which says whether a foot is planted.
    planted = stances(motion.joints, motion.fps, motion.skeleton) if len(motion) > 1 else None
    scale = motion.fps / made.motion.fps
    prompts = [
        {"text": text, "first_frame": min(round(start * scale), len(motion) - 1)}
        for text, start in zip(made.prompts, made.starts, strict=True)
    ]
    return {
        "seed": made.seed,
        "frames": len(motion),
        "fps": motion.fps,
        "seconds": round(motion.seconds, 3),
        "prompts": prompts,
        "data": base64.b64encode(pack_packet(motion, planted=planted)).decode(),
    }


def _slug(title: str) -> str:
    """A file name's stem of a sentence.

    >>> _slug("A person walks, then <b>bows</b>!")
    'a-person-walks-then-b-bows-b'
    """
    return "-".join(re.findall("[a-z0-9]+", title.lower()))[:48].strip("-") or "motion"
