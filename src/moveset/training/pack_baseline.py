"""From a run folder to the model folder of a baseline, which the evaluation reads (``pipelines.baseline_bundle``)."""

import argparse
import sys
from pathlib import Path
from typing import Any

from moveset.data.corpus import Corpus
from moveset.data.dataset import CorpusDataset
from moveset.data.feature_store import FeatureStore
from moveset.errors import InputError, exit_code_of
from moveset.motion.features import get_codec
from moveset.pipelines.baseline_bundle import DENOISER, IDLE, BaselineConfig, save_baseline
from moveset.training import checkpoint, frozen
from moveset.training.dip import idle_pose
from moveset.training.pack import familiarity_limit, known_captions
from moveset.training.reading import embedded


def pack_baseline(
    corpus_path: Path, cache: Path, run: Path, name: str, out: Path, *, guidance: float = 0.0, steps: int | None = None
) -> Path:
    """Write the model folder ``out``.

    Args:
        corpus_path: the corpus that the network was trained on.
        cache: its folder of features and embedded captions.
        run: run folder or checkpoint of ``moveset train`` motiondiffuse, rdm-1, light-rdm-1 or dip.
        name: what the model is called.
        out: the folder to write.
        guidance: default guidance scale.
        steps: K of models of whole clips, 50 if None; DiP takes all of its schedule.

    Raises:
        InputError: no checkpoint there, one of something else, steps for DiP, or a cache of another corpus.
    """
    found = frozen.load(run, "denoiser_ema")
    task = found.task
    chunks = "levels" in task
    if not chunks and (task["flow"] is not None or task["grid"]["condition"] == "clean"):
        raise InputError(f"{run} is a stream's network, which is told the segment before; pack it with pack_stream")
    if chunks and steps is not None:
        raise InputError(f"{run} takes all {task['levels']} steps of its schedule; leave --steps out")
    steps = 50 if steps is None else steps
    corpus, codec = Corpus.open(corpus_path), get_codec(task["codec"])
    store = FeatureStore.cached(CorpusDataset(corpus), codec.name, cache)
    known = known_captions(corpus)
    pooled = embedded(cache, task["text_encoder"], known).pooled_of(known)
    statistics = {"feature_mean": store.normalizer.mean, "feature_std": store.normalizer.std}
    if chunks:
        statistics[IDLE] = idle_pose(CorpusDataset(corpus), store, codec)
    sampling: dict[str, Any] = (
        {"frames": task["model"]["frames"], "prefix": task["model"]["prefix"], "schedule": "cosine", "eta": 1.0,
         "timesteps": task["levels"], "sampler_steps": task["levels"]}
        if chunks
        else {"frames": task["grid"]["frames"], "predict": task["predict"], "sampler_steps": steps}
    )  # fmt: skip
    config = BaselineConfig(
        name=name, codec=codec.name, text_encoder=task["text_encoder"],
        guidance={DENOISER: guidance} if guidance else {},
        far_prompt=familiarity_limit(pooled, task["text_encoder"]),
        provenance={
            "corpus": f"{len(corpus.indices(composed=False))} clips, {corpus.seconds / 3600:.2f} h",
            DENOISER: checkpoint.resolve(run).name.replace("_", " "),
        },
        **sampling,
    )  # fmt: skip
    return save_baseline(out, config, found.module, statistics, known, pooled)


def main() -> None:
    """Command line: ``python -m moveset.training.pack_baseline RUN --out FOLDER``."""
    parser = argparse.ArgumentParser(description=main.__doc__)
    parser.add_argument("run", type=Path, help="such as runs/small/motiondiffuse")
    parser.add_argument("--corpus", type=Path, default=Path("data/corpus.safetensors"))
    parser.add_argument("--cache", type=Path, default=Path("runs/small/cache"))
    parser.add_argument("--guidance", type=float, default=0.0, help="default guidance scale; 0 is none")
    parser.add_argument("--steps", type=int, help="K of models of whole clips; 50 by default")
    parser.add_argument("--name", help="by default that of the run with -small behind it")
    parser.add_argument("--out", type=Path, required=True)
    given = parser.parse_args()
    name = given.name or f"{checkpoint.resolve(given.run).resolve().parent.name}-small"
    print(
        pack_baseline(given.corpus, given.cache, given.run, name, given.out, guidance=given.guidance, steps=given.steps)
    )


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
