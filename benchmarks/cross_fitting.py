"""What the judge's memory is worth: judges that learned from half of the training takes, asked about either half.

    python benchmarks/cross_fitting.py real pcm --corpus data/corpus.safetensors --out runs/cross-fitting

Two judges are trained, one from each half, and judge val: the models given, and for either half the rows `training`
and `nearest`, which are of takes that the judge knows by heart, or of takes that it has never seen. What a row gains by
being known is what copying would gain in the tables. OUT/cross-fitting.json has every value; all of it can be stopped
and called again.
"""

import hashlib
import sys
from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

from arguments import Parser, at_least, write_report
from moveset.data.dataset import CorpusDataset, open_for_training
from moveset.data.splits import Split
from moveset.errors import exit_code_of
from moveset.evaluation.protocol import Protocol
from moveset.evaluation.run import EvaluationConfig, evaluate
from moveset.evaluation.suites import NEAREST, TRAINING
from moveset.training.engine import run
from moveset.training.export import EvaluatorExport, export
from moveset.training.tasks import RECIPES, Sources, load_recipe, task_maker

METRICS = ("r1", "r3", "mm_dist", "fid")


@contextmanager
def half_of_takes(half: int) -> Iterator[None]:
    """Corpora train on half of their takes, by a hash of a take's name, and on what is composed of these alone."""
    whole = CorpusDataset.split

    def split(
        data: CorpusDataset, name: Split, *, composed: bool = True, mirrored: bool = True, untold: bool = False
    ) -> tuple[int, ...]:
        clips = whole(data, name, composed=composed, mirrored=mirrored, untold=untold)
        return clips if name != "train" else tuple(clip for clip in clips if _halves(data, clip // 2) == {half})

    with patch.object(CorpusDataset, "split", split):
        yield


def _halves(data: CorpusDataset, number: int) -> set[int]:
    records = data.corpus.records
    recipe = records[number].recipe
    takes = [records[number]] if recipe is None else [records[part.clip] for part in recipe.parts]
    return {hashlib.sha256(str(take.group).encode()).digest()[0] % 2 for take in takes}


def train(what: str, folder: str, given: Namespace) -> None:
    """To its end, going on where it was.

    Raises:
        KeyboardInterrupt: it was stopped; its checkpoint is there.
    """
    recipe, out = load_recipe(given.recipe, what), given.out
    engine = recipe.engine if given.steps is None else replace(recipe.engine, steps=given.steps)
    sources = Sources(corpus=given.corpus, vae=out / "vae", teacher=out / "movement", cache=out / "cache")
    if run(task_maker(what, recipe.task, sources), engine, out / folder, True).stopped_by:
        raise KeyboardInterrupt


def main() -> None:
    """See the module."""
    parser = Parser(description=main.__doc__)
    parser.add_argument("model", nargs="+", help="as for moveset evaluate")
    parser.add_argument("--corpus", type=Path, default=Path("data/corpus.safetensors"))
    parser.add_argument("--recipe", choices=RECIPES, default="small")
    parser.add_argument("--steps", type=at_least(1), help="of movement encoder and judges; the recipe's by default")
    parser.add_argument("--repeats", type=at_least(1), default=3)
    parser.add_argument("--out", type=Path, default=Path("runs/cross-fitting"))
    given = parser.parse_args()
    protocol = Protocol(split="val", repeats=given.repeats, multimodality=0)
    found: dict[str, dict[str, Any]] = {}
    train("movement", "movement", given)  # of all takes: it reads no sentences
    for half in (0, 1):
        with half_of_takes(half):
            train("evaluator", f"evaluator-{half}", given)
        what = EvaluatorExport(name=f"half-{half}", runs={"evaluator": f"evaluator-{half}"})
        dataset, judge = open_for_training(given.corpus), given.out / what.name
        export(what, dataset, given.out, given.out / "cache", judge)
        config = EvaluationConfig(data=given.corpus, evaluator=str(judge), protocol=protocol)
        for of, said in ((half, "known"), (1 - half, "not known")):
            with half_of_takes(of):
                for model in (TRAINING, NEAREST):
                    folder = given.out / "results" / f"judge-{half}-of-{of}"
                    found.setdefault(f"{model}, {said}", {})[str(half)] = _row(replace(config, model=model), folder)
        for model in given.model:
            folder = given.out / "results" / f"judge-{half}"
            found.setdefault(model, {})[str(half)] = _row(replace(config, model=model), folder)
    for row, judges in found.items():
        print(f"{row:20} R@3 {' '.join(format(judge['r3'], '.3f') for judge in judges.values())}")
    write_report(given.out / "cross-fitting.json", {"steps": given.steps, "repeats": given.repeats, "rows": found})


def _row(config: EvaluationConfig, folder: Path) -> dict[str, float]:
    # In this process, which alone knows of halves.
    result, _ = evaluate(config, folder, processes=1)
    assert result is not None
    return {name: result["metrics"][name]["mean"] for name in METRICS}


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
