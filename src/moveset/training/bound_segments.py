"""A batch of segments with all that networks are told of them bound: text, past, number, place, and the flow.

Shapes: B rows, n frames of a segment, D features, C text width.
"""

from dataclasses import replace
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

NEARER = 0.75
"""Share of the level at which the teacher is asked that a noisy past is told at."""


class BoundSegments:
    """Networks and flow with a batch's text, previous segments and indices bound.

    Args:
        past: noise (B, n, D) of the previous segments as the guided teacher is told them, their sentence embeddings
            (B, C), and which of them are told so (B,), bool; the others, and all where it is None, are told finished,
            as to the student.
    """

    def __init__(
        self, batch: SegmentBatch, text: TextEmbedding, empty: TextEmbedding, transport: Transport, teacher: Denoiser,
        past: tuple[Tensor, Tensor, Tensor] | None = None,
    ) -> None:  # fmt: skip
        self.batch, self.text, self.empty, self.transport, self.teacher = batch, text, empty, transport, teacher
        self.past: tuple[Tensor, ...] | None = None
        if past is not None:
            noise, pooled, noisy_B = past
            before_B = (batch.index - 1).clamp_min(0)
            # Carried back once: the teacher is asked at many levels.
            self.past = (transport.pull(batch.previous, before_B, pooled), noise, before_B, pooled, noisy_B)
        self.clean_level = torch.zeros_like(batch.index)

    def mismatched(self) -> "BoundSegments":
        """The same with the text of another segment that is told something else.

        Sentences are compared, not labels as for clips: another wording of the same counts as something else.
        """
        told = [(caption,) for caption in self.batch.captions]
        others = self.text[torch.tensor(of_another(told), device=self.batch.index.device)]
        return BoundSegments(self.batch, others, self.empty, self.transport, self.teacher)

    def alone(self, rows_B: Tensor) -> "BoundSegments":
        """The same with some segments as first ones: without a past, and in the coordinates of such."""
        # Their example is of the sentence and of no way before it.
        turned_B = self.batch.turned.masked_fill(rows_B, torch.nan)
        batch = replace(self.batch, index=self.batch.index.masked_fill(rows_B, 0), turned=turned_B)
        return BoundSegments(batch, self.text, self.empty, self.transport, self.teacher)

    def push(self, y: Tensor) -> Tensor:
        """x of y."""
        return self.transport.push(y, self.batch.index, self.text.pooled)

    def pull(self, x: Tensor) -> Tensor:
        """y of x."""
        return self.transport.pull(x, self.batch.index, self.text.pooled)

    def guided(self, w_B: Tensor) -> Prediction:
        """The teacher's clean segment under classifier-free guidance."""

        def predict(x: Tensor, t_B: Tensor) -> Tensor:
            condition = self._condition(self.text, *self._past_at(t_B))
            return guided(self.teacher, condition, w_B, self.empty)(x, t_B)

        return predict

    def by(self, network: Denoiser, w_B: Tensor, text: TextEmbedding | None = None) -> Prediction:
        """A student, given another reading of the captions if there is one."""
        return guided(network, self._condition(self.text if text is None else text), w_B)

    def features(self, x: Tensor, t_B: Tensor) -> list[Tensor]:
        """What the frozen teacher's blocks make of x."""
        taps: list[Tensor] = []
        self.teacher(x, t_B, self._condition(self.text), taps)
        return taps

    def _condition(
        self, text: TextEmbedding, previous: Tensor | None = None, level_B: Tensor | None = None
    ) -> Condition:
        """Of a clean past, unless another is given."""
        b = self.batch
        previous, level_B = (b.previous, self.clean_level) if previous is None else (previous, level_B)
        return Condition(text, past=PastSegment(previous, level_B, b.index, b.turned), valid=b.valid)

    def _past_at(self, t_B: Tensor) -> tuple[Tensor, Tensor]:
        """The previous segments as the teacher is told them when it is asked at these levels, and their levels."""
        if self.past is None:
            return self.batch.previous, self.clean_level
        y, noise, before_B, pooled, noisy_B = self.past
        level_B = (NEARER * t_B).long() * noisy_B
        return self.transport.push(add_noise(SCHEDULE, y, noise, level_B), before_B, pooled), level_B

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
