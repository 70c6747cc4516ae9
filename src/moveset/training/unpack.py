"""From a model folder back to run folders, so that training can go on from what ships: the inverse of ``pack``."""

import argparse
import dataclasses
import re
import sys
from pathlib import Path
from typing import Any

from moveset.errors import InputError, exit_code_of
from moveset.pipelines.bundle import Bundle
from moveset.pipelines.model_folder import TEXT_TO_MOTION, find_folder, task_of
from moveset.pipelines.stream_bundle import FLOW, StreamBundle
from moveset.training import checkpoint
from moveset.training.pack_stream import MD, RDM, RUNS
from moveset.training.tasks import RECIPES, load_recipe

# By the task that trains it, what a network is called in its checkpoints.
_SAVED = {
    "vae": "vae", "teacher": "teacher", "lcm": "student", "pcm": "student", "rdm-7": "denoiser", "md-7": "denoiser",
    "rdm-student": "student",
}  # fmt: skip


def unpack(model: str | Path, out: Path, recipe: str = "small") -> dict[str, Path]:
    """Write a model's networks as checkpoints, for ``--vae``, ``--teacher`` and ``--init`` of ``moveset train``.

    A checkpoint has no moments of an optimiser and no discriminator, so it cannot be resumed, only started from. The
    weights are the averaged ones, rounded as they were stored. The length predictor is not among them.

    Args:
        model: name of a shipped model, or a folder.
        out: the folder of all runs; a network goes where ``moveset train`` leaves it (``vae``, ``teacher``, ``pcm-1``
            …; ``rdm-7``, ``md-7``, ``rdm-pcm-1`` …).
        recipe: from which settings of training are taken that the model does not tell.

    Returns:
        The checkpoints by name of the network.

    Raises:
        InputError: no model of clips or streams, or a run of that name is there already.
        FormatError: the model is damaged.
    """
    folder = find_folder(model)
    is_clips = task_of(folder) == TEXT_TO_MOTION
    opened: Any = Bundle(folder) if is_clips else StreamBundle(folder)
    networks = [name for name in opened.config.models if name not in ("length", FLOW)]
    runs = {name: out / (name if is_clips else RUNS[name]) for name in networks}
    for run in runs.values():
        if checkpoint.steps(run):
            raise InputError(f"{run} already holds a training; unpack into another folder")
    return {name: _write(opened, name, run, recipe) for name, run in runs.items()}


def _write(model: Any, name: str, run: Path, recipe: str) -> Path:
    what = _trained_by(name, streams=isinstance(model, StreamBundle))
    settings = dataclasses.asdict(load_recipe(recipe, what).task)
    task = settings | _told(model, name)
    if "grid" in task:
        task["grid"] = settings["grid"] | {"frames": model.config.segment}
    tensors = {}
    # Both averaged and last: whoever goes on begins with the two alike.
    for suffix in ("", "_ema"):
        tensors[_SAVED[what] + suffix] = model.weights(name)
        if task.get("flow"):
            tensors["flow" + suffix] = model.weights(FLOW)
    # A mean of several runs is as far as the last of them.
    step = max(int(number) for number in re.findall(r"\d+", str(model.config.provenance.get(name, "step 0"))))
    origin = f"{model.config.name}: {name}"
    documents = {"config": {"task": what, "config": task, "engine": {}}, "origin": {"model": origin}}
    return checkpoint.write(run, step, tensors, documents)


def _trained_by(name: str, streams: bool) -> str:
    if streams:
        return {RDM: "rdm-7", MD: "md-7"}.get(name, "rdm-student")
    return name.partition("-")[0]


def _told(model: Any, name: str) -> dict[str, Any]:
    """Settings of a network's training that its model knows."""
    config, spec = model.config, model.spec(name)
    told: dict[str, Any] = {"kind": spec.kind, "model": dict(spec.config)}
    told |= {"codec": config.codec} if name == "vae" else {"text_encoder": config.text_encoder}
    phases = {"phases": int(name.partition("-")[2]), "points": config.points} if name.startswith("pcm-") else {}
    if not isinstance(model, StreamBundle):
        return told | phases | ({"points": config.points} if name.startswith("lcm-") else {})
    if phases:
        return told | phases | {"codec": config.codec, "frames": config.segment}
    flow = dict(model.spec(FLOW).config) if config.flows(name) else None
    return told | {"codec": config.codec, "depth_cap": config.depth_cap, "flow": flow}


def main() -> None:
    """Command line: ``python -m moveset.training.unpack motionpcm-small --out runs/small``."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("model", help="name of a shipped model, or a folder")
    parser.add_argument("--out", type=Path, default=Path("runs/small"))
    parser.add_argument("--recipe", choices=RECIPES, default="small")
    given = parser.parse_args()
    for path in unpack(given.model, given.out, given.recipe).values():
        print(path)


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
