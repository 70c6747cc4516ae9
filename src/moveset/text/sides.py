"""Sides beside a sentence: which arm, which leg, and where to turn, written onto the state of its first token.

Sentence encoders hardly tell "left" from "right" (MiniLM's sentences of the two have a cosine of .98), and of the error
of a denoiser one hand or the other is a hundredth. So networks are told of sides by themselves: in training those
that a motion shows, whatever its sentence says, and none of them now and then; otherwise those that a sentence names
(``models.sides``).

Shapes: B sentences, C width of the encoder.
"""

from dataclasses import replace

import torch
from torch import Tensor

from moveset.text.encoder import TextEmbedding

_LOUDNESS = 1.0  # of a number in the state of a token; those of MiniLM have a deviation of .4


def with_sides(text: TextEmbedding, sides_B3: Tensor) -> TextEmbedding:
    """The sentences with sides beside them.

    Args:
        sides_B3: arms, legs, turn: 1 left, -1 right, 0 neither, NaN for what is not said.
    """
    known = ~sides_B3.isnan()
    if not bool(known.any()):
        return text
    numbers_B6 = torch.cat((sides_B3.nan_to_num(), known.to(sides_B3)), dim=1)
    each = text.tokens.shape[-1] // numbers_B6.shape[1]
    said = numbers_B6.repeat_interleave(each, dim=1).to(text.tokens) * _LOUDNESS
    tokens = text.tokens.clone()
    tokens[:, 0, : said.shape[1]] += said
    return replace(text, tokens=tokens)


def forget(sides_B3: Tensor, share: float, generator: torch.Generator) -> Tensor:
    """Sides of which, in ``share`` of the rows, none is said, and in the others each with a chance of a half."""
    at = generator.device
    silent = torch.rand(len(sides_B3), 1, generator=generator, device=at) < share
    left_out = torch.rand(sides_B3.shape, generator=generator, device=at) < 0.5
    return sides_B3.masked_fill((silent | left_out).to(sides_B3.device), torch.nan)
