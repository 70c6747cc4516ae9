"""What a denoiser is given besides noise, and guidance by it: the one way every network is called.

Shapes: B rows, L text tokens, C text width, n frames of a segment or N latent tokens, D features.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import torch
from torch import Tensor, nn

from moveset.diffusion.guidance import cfg
from moveset.errors import InputError
from moveset.text.encoder import TextEmbedding, stack

Prediction = Callable[[Tensor, Tensor], Tensor]
"""``x, t_B -> prediction``: a network with its condition and guidance bound."""


@dataclass(frozen=True, eq=False)
class Condition:
    """A condition of B rows.

    Args:
        text: B sentences; "" is the unconditional input.
        length: (B,) frames of a clip, for networks that read it.
        scale: (B,) guidance scale w, for few-step students only.
    """

    text: TextEmbedding
    length: Tensor | None = None
    scale: Tensor | None = None

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
        parts = {f.name: _cat(getattr(self, f.name), getattr(other, f.name)) for f in fields(self) if f.name != "text"}
        return Condition(stack([self.text, other.text]), **parts)


class Denoiser(nn.Module):
    """``denoiser(x, t_B, condition, taps) -> prediction`` of x's shape: noise or clean data, as it was trained.

    ``prepare`` computes what depends on neither x nor t, once a condition; ``forward`` takes either.
    """

    config: Any

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
            x: noisy latents or frames.
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
        network: any denoiser.
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


def _cat(one: Tensor | None, other: Tensor | None) -> Tensor | None:
    return None if one is None or other is None else torch.cat((one, other))
