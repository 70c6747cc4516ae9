"""What trainings of segments read: segments of both splits, and their captions as embeddings."""

from typing import Any

import torch
from torch import Tensor

from moveset.data.dataset import Dataset, choose_codec, open_for_training
from moveset.data.feature_store import FeatureStore
from moveset.data.loader import Ahead
from moveset.data.segments import SegmentSet
from moveset.data.splits import Split
from moveset.diffusion.coloured import temporal_spectrum
from moveset.errors import InputError
from moveset.text.cache import EmbeddingCache
from moveset.text.encoder import TextEmbedding
from moveset.training.engine import Loop
from moveset.training.reading import embedded, read_captions
from moveset.training.tasks import Sources


class SegmentData:
    """Segments and embedded captions of both splits; what is computed once is kept in the cache folder.

    Args:
        config: the task's; another task's has the same fields where it gives another ``cut``.

    Raises:
        InputError: an encoder that is not here.
    """

    def __init__(self, sources: Sources, config: Any, loop: Loop) -> None:
        self.augmentation = config.augmentation
        self.seed = loop.seed
        self.device = loop.device
        self._ahead = Ahead(loop.config.workers, loop.config.steps)
        with loop.fabric.rank_zero_first():
            self.text = self._open(sources, config, loop)

    def _open(self, sources: Sources, config: Any, loop: Loop) -> EmbeddingCache:
        dataset = open_for_training(sources.corpus)
        loop.learned_from["corpus"] = dataset.fingerprint
        codec = choose_codec(dataset, config.codec)
        store = FeatureStore.cached(dataset, codec.name, sources.cache, loop.rank == 0, loop.config.workers)
        self.codec, self.normalizer = codec, store.normalizer
        self.train = self.cut(config, dataset, "train", store)
        self.val = self.cut(config, dataset, "val", store)
        captions = [*self.train.all_captions(), *self.val.all_captions()]
        return embedded(sources.cache, config.text_encoder, captions, self.device)

    def cut(self, config: Any, dataset: Dataset, split: Split, store: FeatureStore) -> Any:
        return SegmentSet(dataset, split, store, self.codec, config.cutting, config.grid.frames)

    def training_batch(self, size: int, step: int) -> Any:
        """The batch of a training step, where the training computes, its text ready to be read."""
        return self._ahead.get(step, lambda step: self.train.batch(size, self.seed, step)).to(self.device)

    def read(self, captions: list[str], augmented_by: torch.Generator | None = None) -> TextEmbedding:
        """Token states of captions, and their pooled vectors; roughened if given a generator."""
        return read_captions(self.text, captions, self.augmentation, augmented_by)

    def pooled(self, captions: list[str]) -> Tensor:
        """Sentence embeddings (B, C) of captions."""
        return self.text.pooled_of(captions)


def spectrum(data: SegmentSet, segments: int = 4096) -> Tensor:
    """(n, D) spectrum of whole segments (``diffusion.coloured``).

    Raises:
        InputError: there is none.
    """
    batch = data.batch(segments, 0, 0)
    whole = batch.clean[batch.valid.all(dim=1)]
    if not len(whole):
        raise InputError(f"no clip has {data.frames} frames; use fewer frames a segment")
    return temporal_spectrum(whole)


def forecast(data: SegmentSet, segments: int = 8192) -> Tensor:
    """(2, n, D) least-squares weights, in each frame, of the last frame before a segment and of the step to it.

    A little ridge keeps features that hardly change from large weights; all are zero where no segment follows
    another.
    """
    batch = data.batch(segments, 0, 1)
    rows = batch.valid.all(dim=1) & (batch.index > 0)
    clean, last = batch.clean[rows].double(), batch.previous[rows, -1].double()
    step = last - batch.previous[rows, -2].double()
    known = torch.stack((last, step))  # (2, B, D)
    square = torch.einsum("ibd,jbd->dij", known, known)
    square += 1e-3 * max(len(clean), 1) * torch.eye(2, dtype=torch.float64)
    return torch.linalg.solve(square, torch.einsum("ibd,bnd->din", known, clean)).permute(1, 2, 0).float()
