"""What a network of segments is told of each, bound to it: text, timing, heading change, guidance, mirror image.

Shapes: B rows (one a segment), n frames of a segment, D features, L text tokens, C text width.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import torch
from torch import Tensor, nn

from moveset.data.captions import mirror_text
from moveset.diffusion.guidance import cfg
from moveset.models.segment_transformer import told_of
from moveset.models.symmetric import Symmetric
from moveset.pipelines.timeline import Timeline
from moveset.rdm.sequential import Denoise
from moveset.text.cache import CachedEncoder
from moveset.text.encoder import TextEmbedding, stack


@runtime_checkable
class Reader(Protocol):
    """A denoiser that reads text and previous segment apart from denoising."""

    def read(
        self, tokens_BLC: Tensor, mask_BL: Tensor, prev_BnD: Tensor, prev_t_B: Tensor, index_B: Tensor, **told: Tensor
    ) -> object: ...

    def denoise(self, x_BnD: Tensor, t_B: Tensor, context: object, w_B: Tensor | None) -> Tensor: ...


@dataclass(frozen=True, eq=False)
class SegmentCondition:
    """What is known of one segment before it is made.

    Args:
        prompt: its sentence.
        text: the same, encoded.
        mirrored: what it says of the mirror image, encoded, where the network is symmetric.
        timing: segments since the sentence began, and until it ends; negative where that is not known.
        behind: segments before it of the same sentence.
        guidance: scale w.
    """

    prompt: str
    text: TextEmbedding
    mirrored: TextEmbedding | None
    timing: tuple[float, float]
    behind: int
    guidance: float


class Conditioning:
    """Binds conditions to one network.

    Args:
        network: the denoiser.
        texts: encodes prompts.
        guided: whether the network takes the guidance scale as an input; others are evaluated with and without text.
        frames: n.
        device: where to compute.
    """

    def __init__(
        self, network: nn.Module, texts: CachedEncoder, *, guided: bool, frames: int, device: torch.device
    ) -> None:
        self._network, self._texts, self._guided = network, texts, guided
        self._frames, self._device = frames, device
        self._symmetric = isinstance(network, Symmetric)
        self._empty = texts.encode([""]).to(device)

    def of(
        self, line: Timeline, number: int, guidance: float, before: SegmentCondition | None = None
    ) -> SegmentCondition:
        """The condition of a timeline's segment; texts are taken from ``before`` if they are the same."""
        prompt, timing, behind = line.at(number), line.place(number), line.behind(number)
        if before is not None and before.prompt == prompt and (before.mirrored is not None) == self._symmetric:
            return replace(before, timing=timing, behind=behind, guidance=guidance)
        mirrored = self._encoded(mirror_text(prompt)) if self._symmetric else None
        return SegmentCondition(prompt, self._encoded(prompt), mirrored, timing, behind, guidance)

    def evaluations(self, guidance: float) -> int:
        """Rows of the network that one evaluation of a segment takes."""
        return 2 if self._symmetric or (guidance and not self._guided) else 1

    def bind(
        self, conditions: Sequence[SegmentCondition], index_B: Tensor, turned_B: Tensor, *, same_past: bool
    ) -> Denoise:
        """The network with everything bound but noisy segments, their pasts, and the levels of both.

        Args:
            conditions: B rows.
            index_B: numbers of the segments.
            turned_B: heading change, radians, float32, since their sentences began.
            same_past: every call has the same past, so that it and the text are read once.
        """
        w_B = torch.tensor([one.guidance for one in conditions], device=self._device)
        twice = not self._guided and bool(w_B.any())
        times, scale_B, network = 2 if twice else 1, w_B if self._guided else None, self._network
        texts = [one.text for one in conditions]
        texts += [self._empty] * len(texts) if twice else []
        texts += [one.mirrored for one in conditions if one.mirrored is not None]
        text = texts[0] if len(texts) == 1 else stack(texts)
        place_B2 = torch.tensor([one.timing for one in conditions], device=self._device) * float(self._frames)
        told, index_B = told_of(network, place_B2.repeat(times, 1), turned_B.repeat(times)), index_B.repeat(times)
        context: object = None

        def denoise(x_BnD: Tensor, t_B: Tensor, past_BnD: Tensor, past_t_B: Tensor) -> Tensor:
            nonlocal context
            if twice:
                x_BnD, past_BnD = x_BnD.repeat(2, 1, 1), past_BnD.repeat(2, 1, 1)
                t_B, past_t_B = t_B.repeat(2), past_t_B.repeat(2)
            if isinstance(network, Reader):
                if context is None or not same_past:
                    context = network.read(text.tokens, text.mask, past_BnD, past_t_B, index_B, **told)
                made = network.denoise(x_BnD, t_B, context, scale_B)
            else:
                made = network(x_BnD, t_B, past_BnD, past_t_B, index_B, text.tokens, text.mask, scale_B, **told)
            return cfg(*made.chunk(2), w_B) if twice else made

        return denoise

    def _encoded(self, text: str) -> TextEmbedding:
        return self._texts.encode([text]).to(self._device)
