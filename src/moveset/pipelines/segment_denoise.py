"""One denoiser of a stream's folder, with the prompt of every segment in work bound to it.

Shapes: B rows (one a segment in work), n frames of a segment, D features, L text tokens, C text width.
"""

from collections.abc import Sequence
from typing import Protocol, cast, runtime_checkable

import torch
from torch import Tensor, nn

from moveset.data.captions import mirror_text
from moveset.diffusion.guidance import cfg
from moveset.models.segment_transformer import told_of
from moveset.models.symmetric import Symmetric
from moveset.pipelines.course import Course
from moveset.text.cache import CachedEncoder
from moveset.text.encoder import TextEmbedding, stack


@runtime_checkable
class Reader(Protocol):
    """A denoiser that reads text and previous segment apart from denoising."""

    def read(
        self, tokens_BLC: Tensor, mask_BL: Tensor, prev_BnD: Tensor, prev_t_B: Tensor, index_B: Tensor, **told: Tensor
    ) -> object: ...

    def denoise(self, x_BnD: Tensor, t_B: Tensor, context: object, w_B: Tensor | None) -> Tensor: ...


class SegmentDenoise:
    """What ``rdm.sampler`` calls: clean segments of noisy ones; counts the network's evaluations.

    Args:
        network: the denoiser.
        guided: whether it takes the guidance scale as an input; the others are evaluated with and without text.
        guidance: scale w.
        texts: encoded prompts; the empty one is for guidance by two evaluations.
        clean_left: every segment is told its finished predecessor, so text and predecessor are read once for all steps.
        seeded: segment 0 is a given motion, so the one after it is told a clean predecessor at every step.
        course: how far the stream has turned, which is kept here.
        device: where to compute.
    """

    def __init__(
        self,
        network: nn.Module,
        *,
        guided: bool,
        guidance: float,
        texts: CachedEncoder,
        clean_left: bool,
        seeded: bool,
        course: Course,
        device: torch.device,
    ) -> None:
        self._network, self._guided, self._guidance = network, guided, guidance
        self._twice = bool(guidance) and not guided
        self._memory, self._seeded, self._device = texts, seeded, device
        self._empty = texts.encode([""]).to(device)
        self._once = clean_left and isinstance(network, Reader)
        self._even = isinstance(network, Symmetric)
        self._texts: dict[int, TextEmbedding] = {}
        self._mirrored: dict[int, TextEmbedding] = {}
        self._places: dict[int, tuple[int, int]] = {}
        self._behind: dict[int, Tensor] = {}
        self.course = course
        self._context: tuple[int, object] | None = None
        self.evaluations = 0

    def enter(self, segment: int, prompt: str, place: tuple[int, int, int]) -> Tensor:
        """Bind the prompt of a segment, where in its time the segment lies (``Timeline.place``), and how many before it
        are told the same; the sentence embedding (1, C)."""
        self._places[segment], self._behind[segment] = place[:2], torch.tensor([place[2]], device=self._device)
        self._texts[segment] = self._memory.encode([prompt]).to(self._device)
        if self._even:
            self._mirrored[segment] = self._memory.encode([mirror_text(prompt)]).to(self._device)
        return self._texts[segment].pooled

    def leave(self, segment: int) -> None:
        """Forget a finished segment."""
        self._texts.pop(segment, None)
        self._places.pop(segment, None)
        self._behind.pop(segment, None)
        self._mirrored.pop(segment, None)

    def __call__(
        self, x_BnD: Tensor, t_B: Tensor, prev_BnD: Tensor, prev_t_B: Tensor, index_B: Tensor, segments: Sequence[int]
    ) -> Tensor:
        """Clean segments (B, n, D)."""
        rows = len(x_BnD) * (2 if self._twice else 1)
        self.evaluations += len(x_BnD) * (2 if self._twice or self._even else 1)
        if self._seeded and 1 in segments:
            # The sampler's plan has the given motion still in work, at the level of its place in the staircase.
            prev_t_B = prev_t_B * torch.tensor([segment != 1 for segment in segments], device=self._device)
        if self._twice:
            x_BnD, prev_BnD = (z.repeat(2, 1, 1) for z in (x_BnD, prev_BnD))
            t_B, prev_t_B, index_B = (z.repeat(2) for z in (t_B, prev_t_B, index_B))
        w_B = torch.full((rows,), self._guidance, device=self._device) if self._guided else None
        if self._once:
            network = cast(Reader, self._network)
            if self._context is None or self._context[0] != segments[0]:
                text, told = self._text(segments), self._told(segments, x_BnD.shape[1])
                read = network.read(text.tokens, text.mask, prev_BnD, prev_t_B, index_B, **told)
                self._context = (segments[0], read)
            made = network.denoise(x_BnD, t_B, self._context[1], w_B)
        else:
            text, told = self._text(segments), self._told(segments, x_BnD.shape[1])
            made = self._network(x_BnD, t_B, prev_BnD, prev_t_B, index_B, text.tokens, text.mask, w_B, **told)
        if self._twice:
            made = cfg(*made.chunk(2), self._guidance)
        for segment, row in zip(segments, made.split(1), strict=True):
            self.course.made(segment, row, self._behind[segment])
        return made

    def _told(self, segments: Sequence[int], frames: int) -> dict[str, Tensor]:
        times = 2 if self._twice else 1
        place_B2 = torch.tensor([self._places[segment] for segment in segments], device=self._device) * float(frames)
        turned_B = torch.cat([self.course.turned(segment, self._behind[segment]) for segment in segments])
        return told_of(self._network, place_B2.repeat(times, 1), turned_B.repeat(times))

    def _text(self, segments: Sequence[int]) -> TextEmbedding:
        texts = [self._texts[segment] for segment in segments]
        if self._twice:
            texts += [self._empty] * len(texts)
        if self._even:
            texts += [self._mirrored[segment] for segment in segments]
        return texts[0] if len(texts) == 1 else stack(texts)
