"""Batches of crops of clips, for networks that read clips of any length."""

from collections.abc import Sequence

import torch
from torch import Tensor

from moveset.data.augment import MAX_FRAMES
from moveset.data.feature_store import Crop, FeatureStore


class CropSampler:
    """Batches of crops of about equal length, drawn by weight: a pure function of (seed, step).

    Clips are drawn in pools of 16 batches and sorted by length before they are cut into batches: half of the frames
    that a network would otherwise compute are padding.

    Args:
        whole: probability that a clip is taken whole instead of cropped to a random window.
        shortest: the least frames of a window, as a share of the clip and in frames.
    """

    pool = 16

    def __init__(
        self,
        store: FeatureStore,
        clips: Sequence[int],
        weights: Tensor,
        batch: int,
        seed: int,
        whole: float = 0.5,
        shortest: tuple[float, int] = (0.0, 32),
    ) -> None:
        self.store, self.clips, self.weights, self.batch = store, list(clips), weights, batch
        self.seed, self.whole, self.shortest = seed, whole, shortest
        self._pool: tuple[int, list[Crop], list[int]] = (-1, [], [])

    def crops(self, step: int) -> list[Crop]:
        number = step // self.pool
        if self._pool[0] != number:
            self._pool = (number, *self._drawn(number))
        _, crops, order = self._pool
        start = order[step % self.pool] * self.batch
        return crops[start : start + self.batch]

    def _drawn(self, number: int) -> tuple[list[Crop], list[int]]:
        """The crops of a pool by length, and the order of its batches."""
        generator = torch.Generator().manual_seed(self.seed * 1_000_003 + number)
        count = self.pool * self.batch
        drawn = torch.multinomial(self.weights, count, replacement=True, generator=generator)
        share, keep, place = torch.rand(3, count, generator=generator)
        order = torch.randperm(self.pool, generator=generator)
        crops = []
        for k, whole, size, at in zip(drawn.tolist(), keep.tolist(), share.tolist(), place.tolist(), strict=True):
            clip = self.clips[k]
            total = self.store.clips[clip].frames
            least = min(total, max(self.shortest[1], int(self.shortest[0] * total)))
            frames = total if whole < self.whole else least + int(size * (total - least + 1))
            frames = min(frames, total, MAX_FRAMES)
            crops.append(Crop(clip, int(at * (total - frames + 1)), frames))
        crops.sort(key=lambda crop: crop.frames)
        return crops, order.tolist()
