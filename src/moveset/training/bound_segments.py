"""A batch of segments with all that networks are told of them bound: text, past, number, place, and the flow.

Shapes: B rows, n frames of a segment, D features, C text width.
"""

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, replace
from itertools import pairwise

import torch
from torch import Tensor

from moveset.data.segments import SegmentBatch
from moveset.diffusion.steps import add_noise, denoise_step
from moveset.models.condition import Condition, Denoiser, PastSegment, Prediction, guided
from moveset.rdm.transport import Transport
from moveset.text.encoder import TextEmbedding
from moveset.training.adversarial import of_another
from moveset.training.rdm import SCHEDULE


@dataclass(frozen=True, eq=False)
class NoisyPast:
    """How previous segments are told that are not told finished.

    Args:
        noise: (B, n, D) to the level that they are told at.
        pooled: their sentence embeddings (B, C).
        level: that level (B,), int64, of the one (B,) at which a network is asked.
        to_all: student and judge are told so too, not the guided teacher alone.
    """

    noise: Tensor
    pooled: Tensor
    level: Callable[[Tensor], Tensor]
    to_all: bool


class BoundSegments:
    """Networks and flow with a batch's text, previous segments and indices bound.

    Args:
        past: how previous segments are told; None tells all finished.
    """

    def __init__(
        self, batch: SegmentBatch, text: TextEmbedding, empty: TextEmbedding, transport: Transport, teacher: Denoiser,
        past: NoisyPast | None = None,
    ) -> None:  # fmt: skip
        self.batch, self.text, self.empty, self.transport, self.teacher = batch, text, empty, transport, teacher
        self.past = past
        if past is not None:
            self.before_B = (batch.index - 1).clamp_min(0)
            # Carried back once: networks are asked at many levels.
            self.y_past = transport.pull(batch.previous, self.before_B, past.pooled)
        self.clean_level = torch.zeros_like(batch.index)

    def mismatched(self) -> "BoundSegments":
        """The same with the text of another segment that is told something else.

        Sentences are compared, not labels as for clips: another wording of the same counts as something else.
        """
        told, other = [(caption,) for caption in self.batch.captions], copy(self)
        other.text = self.text[torch.tensor(of_another(told), device=self.batch.index.device)]
        return other

    def alone(self, rows_B: Tensor) -> "BoundSegments":
        """The same with some segments as first ones: without a past, and in the coordinates of such."""
        # Their example is of the sentence and of no way before it.
        turned_B, other = self.batch.turned.masked_fill(rows_B, torch.nan), copy(self)
        other.batch = replace(self.batch, index=self.batch.index.masked_fill(rows_B, 0), turned=turned_B)
        return other

    def push(self, y: Tensor) -> Tensor:
        """x of y."""
        return self.transport.push(y, self.batch.index, self.text.pooled)

    def pull(self, x: Tensor) -> Tensor:
        """y of x."""
        return self.transport.pull(x, self.batch.index, self.text.pooled)

    def guided(self, w_B: Tensor) -> Prediction:
        """The teacher's clean segment under classifier-free guidance."""

        def predict(x: Tensor, t_B: Tensor) -> Tensor:
            return guided(self.teacher, self._condition(self.text, t_B, noisy=True), w_B, self.empty)(x, t_B)

        return predict

    def by(self, network: Denoiser, w_B: Tensor, text: TextEmbedding | None = None) -> Prediction:
        """A student, given another reading of the captions if there is one."""
        read = self.text if text is None else text
        return lambda x, t_B: guided(network, self._condition(read, t_B), w_B)(x, t_B)

    def features(self, x: Tensor, t_B: Tensor) -> list[Tensor]:
        """What the frozen teacher's blocks make of x."""
        taps: list[Tensor] = []
        self.teacher(x, t_B, self._condition(self.text, t_B), taps)
        return taps

    def _condition(self, text: TextEmbedding, t_B: Tensor, *, noisy: bool = False) -> Condition:
        """Of who is asked at these levels, told a finished past or, if there is one for it, a ``noisy`` one."""
        b = self.batch
        previous, level_B = b.previous, self.clean_level
        if self.past is not None and (noisy or self.past.to_all):
            previous, level_B = self._past_at(t_B)
        return Condition(text, past=PastSegment(previous, level_B, b.index, b.turned), valid=b.valid)

    def _past_at(self, t_B: Tensor) -> tuple[Tensor, Tensor]:
        """The previous segments as they are told to who is asked at these levels, and their levels."""
        assert self.past is not None
        level_B = self.past.level(t_B)
        noisy = add_noise(SCHEDULE, self.y_past, self.past.noise, level_B)
        return self.transport.push(noisy, self.before_B, self.past.pooled), level_B

    def sample(self, network: Prediction, noise: Tensor, times: tuple[int, ...]) -> Tensor:
        """Clean segments from noise, deterministically over these levels."""
        y = noise
        for t, s in pairwise(times):
            t_B, s_B = (torch.full((len(y),), at, device=y.device) for at in (t, s))
            y = self.land(y, network(self.push(y), t_B), t_B, s_B)
        return self.push(y)

    def land(self, z: Tensor, made: Tensor, t_B: Tensor, s_B: Tensor) -> Tensor:
        """Where noisy segments z at t land at s, in y, if ``made`` (in x) is what they show."""
        return denoise_step(SCHEDULE, z, self.pull(made), t_B, s_B)
