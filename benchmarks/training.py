"""What a step of every training costs: seconds and memory, in small batches, and from these in the recipe's own.

    moveset data export data/corpus.safetensors data/humanml3d --format humanml3d
    python benchmarks/training.py --corpus data/humanml3d --out docs/metrics/training.json
    python benchmarks/training.py --corpus data/humanml3d --device cuda --batches 64 512 --out gpu.json

Each training runs in a process of its own for a few steps, once for each of two batches: time and memory are a constant
and a part for each item of a batch, so these give those of another batch. The first step is not counted. Text of
another encoder (``--text``) takes the place of the recipe's where that is not here: it is frozen, and encoded once.
"""

import argparse
import json
import statistics
import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor
from itertools import pairwise
from multiprocessing import get_context
from pathlib import Path

from arguments import Parser, at_least, report_path, write_report
from moveset.bench.machine import describe_machine, load, peak_mb
from moveset.errors import InputError, exit_code_of
from moveset.training.tasks import RECIPES, load_recipe, load_recipes

STAGES = ("vae", "teacher", "lcm-1", "pcm-1", "rdm-7", "md-7", "light-rdm-1", "motiondiffuse", "dip")
NEEDS = {"teacher": ("vae",), "lcm-1": ("vae", "teacher"), "pcm-1": ("vae", "teacher")}


def settings(recipe: str, stage: str, encoder: str) -> list[str]:
    """What makes a stage read another encoder's text."""
    task = load_recipe(recipe, stage).task
    if encoder == "recipe" or not hasattr(task, "text_encoder"):
        return []
    from moveset.text.encoder import get_text_encoder

    width = get_text_encoder(encoder).dim
    found = [f"text_encoder={encoder}"]
    found += [
        f"{part}.text_dim={width}" for part in ("model", "flow") if hasattr(getattr(task, part, None), "text_dim")
    ]
    return found


def trained(given: argparse.Namespace, stage: str, batch: int, runs: Path) -> dict[str, float]:
    """Runs a training; to be called in a process of its own."""
    import torch

    from moveset.cli.__main__ import main as moveset
    from moveset.training.checkpoint import latest, read_tensors

    folder = runs / stage
    options = ["--recipe", given.recipe, "--corpus", str(given.corpus), "--folder", str(folder), "--resume"]
    options += ["--steps", str(given.steps + 1), "--log-every", "1", "--validate-every", "0", "--keep-last", "1"]
    options += ["--device", given.device, "--threads", str(given.threads), "--tensorboard", "False"]
    options += [word for need in NEEDS.get(stage, ()) for word in (f"--{need}", str(runs / need))]
    chosen = [f"batch={batch}", *settings(given.recipe, stage, given.text)]
    if moveset(["train", stage, *options, *(word for setting in chosen for word in ("--set", setting))]):
        raise InputError(f"{stage} cannot be trained with a batch of {batch}")
    lines = [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
    times = [line["time"] for line in lines if line["split"] == "train"]
    step = latest(folder)
    assert step is not None
    stored = {path.stem for path in step.glob("*.safetensors")}
    learned = {name for name in stored if not name.startswith(("optimizer", "rng")) and not name.endswith("_ema")}
    count = sum(tensor.numel() for name in learned for tensor in read_tensors(step, name).values())
    memory = torch.cuda.max_memory_allocated() * 1e-6 if given.device == "cuda" else peak_mb()
    return {
        "batch": batch,
        "seconds": statistics.median(b - a for a, b in pairwise(times)),
        "memory_mb": memory,
        "parameters": count,
    }


def line(points: list[dict[str, float]], key: str, batch: int) -> float:
    """What two batches say of a third."""
    (low, high) = points
    slope = (high[key] - low[key]) / (high["batch"] - low["batch"])
    return low[key] + slope * (batch - low["batch"])


def main() -> None:
    """See the module."""
    parser = Parser()
    parser.add_argument("--corpus", type=Path, required=True)
    parser.add_argument("--recipe", choices=RECIPES, default="paper")
    parser.add_argument("--stages", nargs="+", default=STAGES)
    parser.add_argument("--batches", nargs=2, type=at_least(1), default=(2, 8))
    parser.add_argument("--steps", type=at_least(2), default=5)
    parser.add_argument("--device", choices=("cpu", "cuda"), default="cpu")
    parser.add_argument("--threads", type=at_least(1), default=2)
    parser.add_argument("--text", default="minilm", help="an encoder of text, or recipe")
    parser.add_argument("--out", type=report_path)
    given = parser.parse_args()
    if unknown := set(given.stages) - set(load_recipes(given.recipe)):
        raise InputError(f"the recipe {given.recipe!r} has no {sorted(unknown)[0]!r}")
    rows: dict[str, dict] = {}
    with tempfile.TemporaryDirectory() as scratch:
        for stage in given.stages:
            points = []
            for batch in sorted(given.batches):
                with ProcessPoolExecutor(1, get_context("spawn")) as alone:
                    runs = Path(scratch) / str(batch)
                    points.append(alone.submit(trained, given, stage, batch, runs).result())
            recipe = load_recipe(given.recipe, stage)
            own, count = recipe.task.batch, points[0].pop("parameters")
            points[1].pop("parameters")
            seconds = line(points, "seconds", own)
            rows[stage] = {
                "parameters": count,
                "measured": points,
                "steps": recipe.engine.steps,
                "batch": own,
                "seconds": seconds,
                "memory_mb": line(points, "memory_mb", own),
                "days": seconds * recipe.engine.steps / 86400,
            }
            print(f"{stage}: {json.dumps(rows[stage])}")
    if given.out:
        about = {"recipe": given.recipe, "device": given.device, "threads": given.threads, "text": given.text}
        write_report(given.out, about | {"machine": describe_machine() | {"load": load()}, "rows": rows})


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
