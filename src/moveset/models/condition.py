"""What a denoiser is given besides noise, and guidance by it: the one way every network is called.

Shapes: B rows, L text tokens, C text width, n frames of a segment or N latent tokens, D features.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from types import MappingProxyType
from typing import Any, Self

import torch
from torch import Tensor, nn

from moveset.diffusion.guidance import cfg
from moveset.errors import InputError
from moveset.text.encoder import TextEmbedding, stack

Prediction = Callable[[Tensor, Tensor], Tensor]
"""``x, t_B -> prediction``: a network with its condition and guidance bound."""


@dataclass(frozen=True, eq=False)
class PastSegment:
    """What a segment goes on from.

    Args:
        frames: (B, m, D) the segment before it; of no meaning in rows of index 0.
        level: (B,) its noise level, 0 for clean.
        index: (B,) number of the segment that is conditioned; 0 is the first, which has none before it.
        heading_change: (B,) radians by which the heading has changed since the sentence began, as the features' yaw
            steps have them; NaN where that is not known.
    """

    frames: Tensor
    level: Tensor
    index: Tensor
    heading_change: Tensor | None = None

    @classmethod
    def clean(cls, frames: Tensor) -> "PastSegment":
        """Finished frames (B, m, D), for every row."""
        zeros = torch.zeros(len(frames), dtype=torch.long, device=frames.device)
        return cls(frames, zeros, zeros + 1)


@dataclass(frozen=True, eq=False)
class Condition:
    """A condition of B rows. Networks read what they know of it.

    Args:
        text: B sentences; "" is the unconditional input.
        length: (B,) frames of a clip.
        past: what segments go on from; None for networks of whole clips.
        scale: (B,) guidance scale w, for few-step students only.
        valid: (B, n) bool, True at frames of the clip; None means all.
        mirror_text: what the sentences say of the mirror image, for networks averaged with theirs.
    """

    text: TextEmbedding
    length: Tensor | None = None
    past: PastSegment | None = None
    scale: Tensor | None = None
    valid: Tensor | None = None
    mirror_text: TextEmbedding | None = None

    def __len__(self) -> int:
        return len(self.text)

    def dropped(self, empty: TextEmbedding) -> "Condition":
        """The same with the unconditional input instead of the text (condition dropout of every row).

        Args:
            empty: the encoded empty sentence, one row.
        """
        return replace(self, text=stack([empty] * len(self)))

    def joined(self, other: "Condition") -> "Condition":
        """The rows of both, in order; both must have the same parts."""
        return _joined(self, other)


class Denoiser(nn.Module):
    """``denoiser(x, t_B, condition, taps) -> prediction`` of x's shape: noise or clean data, as it was trained.

    ``prepare`` computes what depends on neither x nor t, once a condition; ``forward`` takes either.
    """

    config: Any
    #: Settings in which students differ.
    of_students: Mapping[str, Any] = MappingProxyType({})

    def student(self) -> Self:
        """A copy with a guidance embedding that changes nothing yet: the start of distillation."""
        made = replace(self.config, guided=True, **self.of_students).build().to(next(self.parameters()))
        made.load_state_dict({**made.state_dict(), **self.state_dict()})
        return made.train(self.training)

    @property
    def takes_scale(self) -> bool:
        """Whether the guidance scale is an input (few-step students), so that guidance costs one evaluation."""
        return bool(getattr(self.config, "guided", False))

    def prepare(self, condition: Condition) -> Any:
        """The part of an evaluation that depends on the condition alone, for any number of evaluations."""
        return condition

    def denoise(self, x: Tensor, t_B: Tensor, prepared: Any, taps: list[Tensor] | None) -> Tensor:
        """As ``forward``, for a condition that was prepared."""
        raise NotImplementedError

    def forward(self, x: Tensor, t_B: Tensor, condition: Any, taps: list[Tensor] | None = None) -> Tensor:
        """The prediction, of x's shape.

        Args:
            t_B: (B,) their noise levels.
            condition: a ``Condition``, or what ``prepare`` made of one.
            taps: a list that receives every block's output, for the discriminator.
        """
        prepared = self.prepare(condition) if isinstance(condition, Condition) else condition
        return self.denoise(x, t_B, prepared, taps)


def guided(
    network: Denoiser, condition: Condition, w: Tensor | float | None = None, empty: TextEmbedding | None = None
) -> Prediction:
    """A network with its condition and guidance bound.

    Students take the guidance scale as an input; other networks are evaluated with and without text in one batch and
    extrapolated (classifier-free guidance, MotionPCM, Eq. 11). Where no gradient is wanted the condition is prepared
    once.

    Args:
        condition: B rows.
        w: guidance scale, one or (B,); None leaves guidance out.
        empty: the encoded empty sentence, one row, for networks that do not take the scale.

    Raises:
        InputError: guidance of a network that neither takes the scale nor was given the empty sentence.
    """
    twice = w is not None and not network.takes_scale
    if twice:
        if empty is None:
            raise InputError(
                f"guidance by w = {w} of a network without a scale input needs the encoded empty sentence; give empty"
            )
        condition = condition.joined(condition.dropped(empty))
    elif w is not None:
        tokens = condition.text.tokens
        w_B = torch.as_tensor(w, dtype=torch.float32, device=tokens.device).expand(len(condition))
        condition = replace(condition, scale=w_B)
    bound: Any = condition if torch.is_grad_enabled() else network.prepare(condition)

    def predict(x: Tensor, t_B: Tensor) -> Tensor:
        if not twice or w is None:
            return network(x, t_B, bound).float()
        both = network(x.repeat(2, *(1,) * (x.ndim - 1)), t_B.repeat(2), bound).float()
        return cfg(*both.chunk(2), w)

    return predict


def _joined(one: Any, other: Any) -> Any:
    """Two like conditions, or parts of such, as one; None where there is none."""
    if one is None:
        return None
    if isinstance(one, TextEmbedding):
        return stack([one, other])
    if isinstance(one, Condition | PastSegment):
        return type(one)(**{f.name: _joined(getattr(one, f.name), getattr(other, f.name)) for f in fields(one)})
    return torch.cat((one, other))
