"""What trainings of segments read: segments of both splits, and their captions as embeddings."""

from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from moveset.data.splits import Split
from moveset.errors import InputError
from moveset.motion.features import get_codec
from moveset.text.cache import EmbeddingCache
from moveset.text.encoder import TextEmbedding
from moveset.text.live import LiveEmbeddings
from moveset.training.ahead import Ahead
from moveset.training.clip_source import ClipSource, open_clips
from moveset.training.clips import FeatureStore
from moveset.training.engine import Loop
from moveset.training.reading import AS_WRITTEN, MAX_TOKENS, Disturbance, open_text, read_captions
from moveset.training.segments import SegmentSet
from moveset.training.tasks import Sources


class SegmentData:
    """Segments and embedded captions of both splits; what is computed once is kept in the cache folder.

    Args:
        config: the task's; another task's has the same fields where it gives another ``cut``.

    Raises:
        InputError: disturbed captions that are to be read further than that is possible, or as of ``open_text``.
    """

    def __init__(self, sources: Sources, config: Any, loop: Loop) -> None:
        if config.max_tokens != MAX_TOKENS and config.disturbance != AS_WRITTEN:
            raise InputError(f"disturbed captions are read to {MAX_TOKENS} tokens; set max_tokens to that")
        self.disturbance, self.max_tokens = config.disturbance, config.max_tokens
        self.seed = loop.config.seed * 64 + loop.rank
        self.device = loop.device
        self._ahead = Ahead(loop.config.workers, loop.config.steps)
        with loop.fabric.rank_zero_first():
            self.text = self._open(sources, config, loop.rank == 0)

    def _open(self, sources: Sources, config: Any, progress: bool) -> EmbeddingCache | LiveEmbeddings:
        source, codec = open_clips(sources.corpus), get_codec(config.codec)
        folder = sources.cache / f"features-{codec.name}"
        store = FeatureStore.of(source, codec, folder, progress)
        self.codec, self.normalizer = codec, store.normalizer
        self.train = self.cut(config, source, "train", store, folder, config.disturbance)
        self.val = self.cut(config, source, "val", store, folder, AS_WRITTEN)
        captions, others = self.train.all_captions(), self.val.all_captions()
        return open_text(sources.cache, config.text_encoder, captions, others, config.disturbance, self.device)

    def cut(
        self,
        config: Any,
        source: ClipSource,
        split: Split,
        store: FeatureStore,
        folder: Path,
        disturbance: Disturbance,
    ) -> Any:
        """Segments of a split."""
        frames, cutting = config.grid.frames, config.cutting
        return SegmentSet(source, split, store, self.codec, frames, cutting, folder, disturbance)

    def training_batch(self, size: int, step: int) -> Any:
        """The batch of a training step, where the training computes, its text ready to be read."""
        batch = self._ahead.get(step, lambda step: self.train.batch(size, self.seed, step)).to(self.device)
        self.text.prepare(batch.said)
        return batch

    def read(self, captions: list[str], disturbed_by: torch.Generator | None = None) -> TextEmbedding:
        """Token states of captions, and their pooled vectors; roughened if given a generator."""
        if self.disturbance == AS_WRITTEN:
            return self.text.lookup(captions, self.max_tokens)
        return read_captions(self.text, captions, self.disturbance, disturbed_by)

    def pooled(self, captions: list[str]) -> Tensor:
        """Sentence embeddings (B, C) of captions."""
        return self.text.pooled_of(captions)
