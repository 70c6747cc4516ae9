"""How well a model folder's autoencoder gives real takes back: position errors, jerk and skating, split by split.

python benchmarks/reconstruction.py --model src/moveset/weights/motionpcm-small --out results/reconstruction.json
"""

import sys
from pathlib import Path

import torch

from arguments import Parser, at_least, report_path, write_report
from moveset.data.corpus import Corpus
from moveset.data.dataset import CorpusDataset
from moveset.data.feature_store import Crop, FeatureStore
from moveset.errors import InputError, exit_code_of
from moveset.motion.features import Normalizer, get_codec
from moveset.pipelines.model_config import ClipConfig
from moveset.pipelines.model_folder import ModelFolder
from moveset.training.vae import reconstruction_report


def main() -> None:
    """See the module."""
    parser = Parser()
    parser.add_argument("--model", type=Path, required=True)
    parser.add_argument("--corpus", type=Path, default=Path("data/corpus.safetensors"))
    parser.add_argument("--cache", type=Path, default=Path("runs/small/cache"))
    parser.add_argument("--threads", type=at_least(1), default=2)
    parser.add_argument("--out", type=report_path)
    given = parser.parse_args()
    torch.set_num_threads(given.threads)
    bundle, corpus = ModelFolder.open(given.model, ClipConfig), Corpus.open(given.corpus)
    codec = get_codec(bundle.config.codec)
    store = FeatureStore.of(
        CorpusDataset(corpus), codec, given.cache / f"features-{bundle.config.codec}", progress=True
    )
    n = bundle.normalizer
    trained = Normalizer(n["feature_mean"], n["feature_std"])
    if not (torch.allclose(trained.mean, store.normalizer.mean) and torch.allclose(trained.std, store.normalizer.std)):
        raise InputError("the feature cache has other statistics than the model; delete the cache")
    vae, rows = bundle.module("vae"), {}
    for split in ("val", "test"):
        takes = corpus.indices(split, composed=False)
        crops = sorted((Crop(2 * k, 0, store.clips[2 * k].frames) for k in takes), key=lambda crop: crop.frames)
        rows[split] = reconstruction_report(vae, store, crops, codec, torch.device("cpu")) | {"takes": len(takes)}
        print(split, rows[split])
        for source in sorted({corpus.records[k].source for k in takes}):
            some = [crop for crop in crops if corpus.records[crop.clip // 2].source == source]
            rows[f"{split} {source}"] = reconstruction_report(vae, store, some, codec, torch.device("cpu"))
            rows[f"{split} {source}"]["takes"] = len(some)
            print(split, source, rows[f"{split} {source}"])
    if given.out:
        write_report(given.out, rows)


if __name__ == "__main__":
    sys.exit(exit_code_of(main))
