"""What a network of segments is told of each, bound to it: text, heading change, guidance, mirror image.

Shapes: B rows (one a segment), n frames of a segment, D features, L text tokens, C text width.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from moveset.data.captions import mirror_text
from moveset.models.condition import Condition, Denoiser, PastSegment, Prediction, guided
from moveset.models.symmetric import Symmetric
from moveset.pipelines.model_config import StreamConfig
from moveset.pipelines.model_folder import ModelFolder
from moveset.pipelines.sides import read_sides
from moveset.pipelines.timeline import Timeline
from moveset.rdm.sequential import Denoise
from moveset.text.cache import CachedEncoder
from moveset.text.encoder import TextEmbedding, stack


@dataclass(frozen=True, eq=False)
class SegmentCondition:
    """What is known of one segment before it is made.

    Args:
        mirrored: what it says of the mirror image, encoded, where the network is symmetric.
        behind: segments before it of the same sentence.
        guidance: scale w.
    """

    prompt: str
    text: TextEmbedding
    mirrored: TextEmbedding | None
    behind: int
    guidance: float


class Conditioning:
    """Binds conditions to one network of a model folder."""

    def __init__(
        self, bundle: ModelFolder[StreamConfig], network: Denoiser, texts: CachedEncoder, device: torch.device
    ) -> None:
        self._bundle, self._network, self._texts, self._device = bundle, network, texts, device
        self._symmetric = isinstance(network, Symmetric)
        self._empty = texts.encode([""]).to(device)

    def of(
        self, line: Timeline, number: int, guidance: float, before: SegmentCondition | None = None
    ) -> SegmentCondition:
        """The condition of a timeline's segment; texts are taken from ``before`` if they are the same."""
        prompt, behind = line.at(number), line.behind(number)
        if before is not None and before.prompt == prompt and (before.mirrored is not None) == self._symmetric:
            return replace(before, behind=behind, guidance=guidance)
        mirrored = self._encoded(mirror_text(prompt)) if self._symmetric else None
        return SegmentCondition(prompt, self._encoded(prompt), mirrored, behind, guidance)

    def evaluations(self, guidance: float) -> int:
        """Rows of the network that one evaluation of a segment takes."""
        return 2 if self._symmetric or (guidance and not self._network.takes_scale) else 1

    def bind(
        self, conditions: Sequence[SegmentCondition], index_B: Tensor, turned_B: Tensor, *, same_past: bool
    ) -> Denoise:
        """The network with everything bound but noisy segments, their pasts, and the levels of both.

        Args:
            conditions: B rows.
            turned_B: heading change, radians, float32, since their sentences began.
            same_past: every call has the same past, so that it and the text are read once.
        """
        w_B = torch.tensor([one.guidance for one in conditions], device=self._device)
        w = w_B if self._network.takes_scale or bool(w_B.any()) else None
        text = stack([one.text for one in conditions])
        mirrored = [one.mirrored for one in conditions if one.mirrored is not None]
        bound: Prediction | None = None

        def denoise(x_BnD: Tensor, t_B: Tensor, past_BnD: Tensor, past_t_B: Tensor) -> Tensor:
            nonlocal bound
            if bound is None or not same_past:
                past = PastSegment(past_BnD, past_t_B, index_B, turned_B)
                condition = Condition(text, past=past, mirror_text=stack(mirrored) if mirrored else None)
                bound = guided(self._network, condition, w, self._empty)
            return bound(x_BnD, t_B)

        return denoise

    def _encoded(self, text: str) -> TextEmbedding:
        return read_sides(self._bundle, self._texts.encode([text]).to(self._device), self._device)
