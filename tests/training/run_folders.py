"""A corpus with its cache, and run folders as the training leaves them, for what packs them."""

from dataclasses import asdict
from pathlib import Path

from torch import nn

from moveset.data.corpus import Corpus
from moveset.data.dataset import CorpusDataset
from moveset.data.feature_store import FeatureStore
from moveset.data.synthetic import synthetic_corpus
from moveset.text.cache import EmbeddingCache
from moveset.text.encoder import get_text_encoder
from moveset.training import checkpoint
from moveset.training.pack import known_captions


def write_corpus(folder: Path) -> None:
    """``corpus.safetensors``, and ``runs/cache`` with its features and captions."""
    corpus = Corpus.open(synthetic_corpus(folder / "corpus.safetensors", clips=12, seed=0))
    FeatureStore.cached(CorpusDataset(corpus), "native", folder / "runs" / "cache")
    captions = known_captions(corpus)
    EmbeddingCache.build(get_text_encoder("minilm"), captions, folder / "runs" / "cache" / "text-minilm.safetensors")


def write_run(folder: Path, name: str, task: object, **modules: nn.Module) -> None:
    """``runs/NAME`` with checkpoints of steps 3 and 7; the later one holds the modules as they are."""
    config = {"config": asdict(task)}  # type: ignore[call-overload]
    for step, offset in ((3, 1.0), (7, 0.0)):
        tensors = {k: {key: value + offset for key, value in m.state_dict().items()} for k, m in modules.items()}
        checkpoint.write(folder / "runs" / name, step, tensors, {"config": config})
