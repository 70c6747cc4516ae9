"""The row that a model has to beat: for each prompt the training clip whose sentence is most like it.

Shapes: K sentences, C width of a sentence's embedding, F frames, J joints.
"""

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import torch
from torch import Tensor

from moveset.data.dataset import Dataset
from moveset.data.splits import Split
from moveset.errors import InputError
from moveset.evaluation.generators import Tick, Wanted, resampled
from moveset.text.encoder import get_text_encoder

_AT_ONCE = 256  # sentences


class NearestClip:
    """Motions of the training split, found by their sentences; a clip that is shorter than wanted stays so.

    Sentences are compared as MiniLM reads them, by their cosine.

    Args:
        dataset: of the training; mirror images and compositions take part.

    Raises:
        InputError: there are no training clips.
    """

    slug = model = "nearest"
    network, steps, random, segment = None, None, False, 0.0

    def __init__(self, dataset: Dataset) -> None:
        if not dataset.split("train"):
            raise InputError(f"{dataset.name} has no training clips, of which 'nearest' is one; leave that row out")
        self._dataset, self._encoder = dataset, get_text_encoder()

    @cached_property
    def _told(self) -> dict[str, int]:
        """Clips by their sentences."""
        clips = self._dataset.split("train")
        return {caption: clip for clip in clips for caption in self._dataset.clip(clip).captions}

    @cached_property
    def _known_KC(self) -> Tensor:
        return self._pooled(list(self._told))

    def describe(self) -> dict[str, Any]:
        return {"sentences": len(self._told), "encoder": self._encoder.name}

    def weights(self) -> dict[str, str]:
        """What motions are taken from, where the hash of the judged split does not say it: a corpus has one for all."""
        learned = self._dataset.sha256("train")
        judged: tuple[Split, ...] = ("val", "test")
        return {} if all(self._dataset.sha256(split) == learned for split in judged) else {"train split": learned}

    def generate(self, wanted: Sequence[Wanted], fps: float, tick: Tick = lambda count: None) -> list[Tensor]:
        prompts = [one.parts[0][0] for one in wanted]
        found = (self._pooled(prompts) @ self._known_KC.T).argmax(dim=1).tolist()
        clips, made = list(self._told.values()), []
        for one, place in zip(wanted, found, strict=True):
            clip = self._dataset.clip(clips[place])
            made.append(resampled(clip.joints(), clip.fps, fps)[: one.frames].clone())
            tick(1)
        return made

    def _pooled(self, sentences: list[str]) -> Tensor:
        parts = [sentences[k : k + _AT_ONCE] for k in range(0, len(sentences), _AT_ONCE)]
        return torch.cat([self._encoder.encode(part).pooled for part in parts])
