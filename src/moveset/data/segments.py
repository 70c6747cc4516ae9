"""A dataset as a recurrent model sees it: a segment, the one before it, and what is being said while it plays.

A clip that shows one thing after another has a sentence for each, so the prompt of a segment is the sentence of the
part that fills more of it: this is how a stream is steered.

Shapes: B rows, n frames of a segment, D features.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor

from moveset.data.augment import MAX_FRAMES
from moveset.data.batch import Batch
from moveset.data.dataset import Dataset
from moveset.data.feature_store import FeatureStore
from moveset.data.splits import Split
from moveset.errors import InputError
from moveset.motion.features import FeatureCodec
from moveset.motion.sides import favoured

# Frames of a segment by N, the number of segments of the longest clip.
SEGMENT_FRAMES = {count: MAX_FRAMES // count for count in (1, 4, 7, 14)}
_LEAST_VALID = 8


@dataclass(frozen=True, kw_only=True)
class CuttingConfig:
    """Where segments are cut and what is said to them.

    Args:
        aligned: only at multiples of n from a clip's first frame, with the true segment index (the paper); otherwise
            anywhere, and the index is 0, 1 (after a first segment) or 2 (any later one).
        horizon: when aligned, the longest clip; of longer ones so many frames in a row are shown.
        first_share: share of first segments, when not aligned; most of them start where their clip does.
        whole_caption: share of segments of clips in two parts that get the sentence for all of it.
        composed_share: share of segments from compositions.
        take_share: share of segments from takes of which several clips in a row are told, so that one sentence follows
            another as it did when people moved.
        changes: when not aligned, share of later segments that lie where the sentence changes, in clips in which it
            does: most of a clip lies elsewhere, and to react is what streams are for.
        livelier: when not aligned, share of later segments for which two places are drawn and the one is taken where
            more happens: of a jump that was captured for ten seconds, most shows somebody who stands.

    Raises:
        InputError: a share that is not in 0 to 1, or a horizon of no frames.
    """

    aligned: bool = False
    horizon: int = MAX_FRAMES
    first_share: float = 0.2
    whole_caption: float = 0.2
    composed_share: float = 0.35
    take_share: float = 0.0
    changes: float = 0.0
    livelier: float = 0.0

    def __post_init__(self) -> None:
        for name in ("first_share", "whole_caption", "composed_share", "take_share", "changes", "livelier"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise InputError(f"cutting.{name} {getattr(self, name)} is not in 0 to 1")
        if self.horizon < 1:
            raise InputError(f"cutting.horizon {self.horizon} is no number of frames")


@dataclass(frozen=True, eq=False)
class SegmentBatch(Batch):
    """Clean segments and what belongs to them.

    Args:
        clean: (B, n, D), zero beyond ``valid`` (B, n).
        previous: (B, n, D) the segment before, zero for first ones; never partial.
        first: (B, n, D) the first segment of the clip.
        index: (B,) segment number.
        begun: (B,) whether the sentence began before the segment.
        turned: (B,) radians by which the heading has changed since the sentence began.
        sides: (B, 3) sides favoured by what the sentence is said to (``motion.sides``).
        captions: what is said to the segment, and ``previous_captions`` to the one before.
    """

    clean: Tensor
    valid: Tensor
    previous: Tensor
    first: Tensor
    index: Tensor
    begun: Tensor
    turned: Tensor
    sides: Tensor
    captions: list[str]
    previous_captions: list[str]


@dataclass(frozen=True, eq=False)
class Row:
    """A clip, or several of one take in a row.

    Args:
        pieces: normalised features (F, D), one after the other.
        ends: the frames at which its parts end.
        said: the sentences of each part.
        whole: those of all of it, if any.
        sides: (parts + 1, 3) sides favoured by each part and, in the last row, by all of it (``motion.sides``).
    """

    pieces: tuple[np.ndarray, ...]
    ends: tuple[int, ...]
    said: tuple[tuple[str, ...], ...]
    whole: tuple[str, ...]
    sides: Tensor

    def __len__(self) -> int:
        return sum(map(len, self.pieces))

    def cut(self, start: int, stop: int) -> np.ndarray:
        """A copy of frames [start, stop), as far as there are any."""
        found, at = [], 0
        for piece in self.pieces:
            found.append(piece[max(start - at, 0) : max(stop - at, 0)])
            at += len(piece)
        return np.concatenate(found)


class ClipSet:
    """Clips of one split with their sentences by part, drawn by weight."""

    def __init__(
        self,
        dataset: Dataset,
        split: Split,
        store: FeatureStore,
        codec: FeatureCodec,
        cutting: CuttingConfig,
    ) -> None:
        self.cutting = cutting
        yaw, self._moving = codec.groups["root_yaw"], codec.groups["velocities"]
        self._yaw = (yaw.start, float(store.normalizer.mean[yaw]), float(store.normalizer.std[yaw]))
        clips = dataset.split(split)
        weights = dataset.weights(clips, power=0.25, composed_share=cutting.composed_share)
        self.rows = [_row(dataset, clip, store, codec) for clip in clips]
        self.weights = weights / weights.sum()
        if cutting.take_share and (takes := [part for take in dataset.takes(split) for part in _unbroken(take, store)]):
            self.rows += [_take(dataset, take, store) for take in takes]
            chance = dict(zip(clips, weights.tolist(), strict=True))
            more = torch.tensor([sum(chance[clip] for clip, _ in take) for take in takes], dtype=torch.float64)
            share = cutting.take_share
            self.weights = torch.cat((self.weights * (1 - share), more / more.sum() * share))

    def all_captions(self) -> list[str]:
        return sorted({caption for row in self.rows for said in (row.whole, *row.said) for caption in said})

    def draw(self, size: int, seed: int, step: int) -> list[tuple[Row, list[float]]]:
        """The clips of a step's batch, each with six numbers in [0, 1): a pure function of (seed, step)."""
        generator = torch.Generator().manual_seed(seed * 1_000_003 + step)
        chosen = torch.multinomial(self.weights, size, replacement=True, generator=generator).tolist()
        numbers = torch.rand(size, 6, generator=generator).tolist()
        return [(self.rows[row], chance) for row, chance in zip(chosen, numbers, strict=True)]

    def say(self, clip: Row, start: int, frames: int, chance: Sequence[float]) -> tuple[str, int, Tensor]:
        """A sentence for these frames, chosen by two numbers in [0, 1), and of what it is said to: the part that fills
        more of them, or all of the clip, the first frame and the sides (3,) that it favours."""
        if clip.whole and chance[0] < self.cutting.whole_caption:
            options, since, sides = clip.whole, 0, clip.sides[-1]
        else:
            middle = start + frames // 2
            part = next((k for k, end in enumerate(clip.ends) if middle < end), len(clip.ends) - 1)
            options, since, sides = clip.said[part], (0, *clip.ends)[part], clip.sides[part]
        return options[int(chance[1] * len(options))], since, sides

    def turned(self, clip: Row, start: int, stop: int) -> float:
        """Radians by which the heading changes from one frame to a later one; 0 where that one is none."""
        column, mean, std = self._yaw
        steps = clip.cut(start, stop)[:, column]
        return float(steps.sum(dtype=np.float64)) * std + len(steps) * mean


class SegmentSet(ClipSet):
    """Segments of ``frames`` frames of one split; other arguments as for ``ClipSet``."""

    def __init__(
        self,
        dataset: Dataset,
        split: Split,
        store: FeatureStore,
        codec: FeatureCodec,
        cutting: CuttingConfig,
        frames: int,
    ) -> None:
        super().__init__(dataset, split, store, codec, cutting)
        self.frames = frames

    def batch(self, size: int, seed: int, step: int) -> SegmentBatch:
        """The batch of a step: a pure function of (seed, step)."""
        n, width = self.frames, self.rows[0].pieces[0].shape[1]
        clean, previous, first = torch.zeros(3, size, n, width)
        valid, index = torch.zeros(size, n, dtype=torch.bool), torch.zeros(size, dtype=torch.long)
        begun, turned, sides = torch.zeros(size, dtype=torch.bool), torch.zeros(size), torch.zeros(size, 3)
        captions, before = [], []
        for k, (clip, chance) in enumerate(self.draw(size, seed, step)):
            begin, start, stop, number = self._place(clip, chance)
            piece = clip.cut(start, stop)
            clean[k, : len(piece)] = torch.from_numpy(piece)
            valid[k, : len(piece)] = True
            index[k] = number
            head = clip.cut(begin, begin + n)
            first[k, : len(head)] = torch.from_numpy(head)
            if number:
                previous[k] = torch.from_numpy(clip.cut(start - n, start))
            told, since, sides[k] = self.say(clip, start, len(piece), chance[3:])
            begun[k] = since < start
            turned[k] = self.turned(clip, since, start)
            captions.append(told)
            before.append(self.say(clip, max(start - n, 0), n, chance[3:])[0] if number else told)
        return SegmentBatch(clean, valid, previous, first, index, begun, turned, sides, captions, before)

    def _place(self, clip: Row, chance: Sequence[float]) -> tuple[int, int, int, int]:
        """Where the sequence begins that a segment of a clip belongs to, first frame, end and index of the segment."""
        n, total = self.frames, len(clip)
        if self.cutting.aligned:
            shown = min(total, self.cutting.horizon)
            begin = int(chance[1] * (total - shown + 1))
            number = int(chance[0] * -(-shown // n))
            start = begin + number * n
            return begin, start, min(start + n, begin + shown), number
        room = total - _LEAST_VALID - n
        if chance[0] < self.cutting.first_share or room < 0:
            inside = max(total - n, 0)
            start, number = (0 if chance[1] < 0.75 else int(chance[2] * (inside + 1))), 0
        else:
            start, seams = n + int(chance[1] * (room + 1)), clip.ends[:-1]
            if chance[5] < self.cutting.changes and seams:
                # Anywhere where at least half of the segment is told the new sentence, and half of the past was not.
                around = seams[int(chance[1] * len(seams))] + int((chance[2] - 0.5) * (n + 1))
                start = min(max(around, n), n + room)
            elif chance[5] > 1 - self.cutting.livelier:
                start = max(start, n + int(chance[2] * (room + 1)), key=lambda at: self._movement(clip, at))
            # The segment before is a first one only where the clip begins with it; beyond that the number has no
            # meaning.
            number = 1 if start == n else 2
        return 0, start, start + n, number

    def _movement(self, clip: Row, start: int) -> float:
        """How much joints move in a segment: mean size of their velocities, normalised."""
        return float(np.abs(clip.cut(start, start + self.frames)[:, self._moving]).mean())


def _row(dataset: Dataset, item: int, store: FeatureStore, codec: FeatureCodec) -> Row:
    clip, features, sides = dataset.clip(item), store.of_clip(item), store.sides[item]
    if not clip.parts:
        return Row((features,), (len(features),), (clip.captions,), clip.captions, sides.expand(2, 3))
    stops = (*(part.stop for part in clip.parts[:-1]), len(features))
    joints = codec.joints(store.normalizer.denormalize(torch.from_numpy(np.array(features))))
    of_parts = [favoured(joints[a:b], codec.skeleton) for a, b in pairwise((0, *stops))]
    said = tuple(part.captions for part in clip.parts)
    return Row((features,), stops, said, clip.captions, torch.stack((*of_parts, sides)))


def _unbroken(take: Sequence[tuple[int, int]], store: FeatureStore) -> list[list[tuple[int, int]]]:
    """A take without the places where a row is missing between two clips; what is left of it that has two or more.

    Features that need a frame's successor have a row less than a clip has frames. Of clips that share no frame it is
    that of the step from one to the next, and a jump over it is no movement.
    """
    parts = [[take[0]]]
    for (before, first), (clip, begin) in pairwise(take):
        if first + store.clips[before].frames < begin:
            parts.append([])
        parts[-1].append((clip, begin))
    return [part for part in parts if len(part) > 1]


def _take(dataset: Dataset, take: Sequence[tuple[int, int]], store: FeatureStore) -> Row:
    """Clips of one take in a row; of frames that two of them show, each has half."""
    begins = [first for _, first in take]
    ends = [first + len(store.of_clip(clip)) for clip, first in take]
    seams = [begins[0], *((end + begin) // 2 for end, begin in zip(ends, begins[1:], strict=False)), ends[-1]]
    pieces = tuple(
        store.of_clip(clip)[seam - first : until - first]
        for (clip, first), seam, until in zip(take, seams, seams[1:], strict=False)
    )
    said = tuple(dataset.clip(clip).captions for clip, _ in take)
    sides = store.sides[[clip for clip, _ in take]]
    # Nothing is said of the whole.
    return Row(pieces, tuple(seam - seams[0] for seam in seams[1:]), said, (), torch.cat((sides, sides[:1] * 0)))
