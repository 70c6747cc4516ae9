"""Words as the evaluator reads them: a vector each, with a class of speech where the vectors need one.

Shapes: B sentences, L words of the longest, W width of a word, P classes of speech.
"""

from collections.abc import Sequence
from typing import Protocol

import torch
from torch import Tensor

from moveset.text.encoder import TextEmbedding, TextEncoder

MAX_WORDS = 32
"""Tokens of a sentence that an evaluator reads where nothing else is said."""


class Said(Protocol):
    """A caption with its "lemma/PART_OF_SPEECH" tokens: ``data.humanml3d.Caption``."""

    @property
    def text(self) -> str: ...

    @property
    def tokens(self) -> tuple[str, ...]: ...


class Words(Protocol):
    """Sentences to sequences of word vectors. ``name`` identifies it in checkpoints, ``width`` is W, ``classes`` P."""

    name: str
    width: int
    classes: int

    def read(self, captions: Sequence[Said | str]) -> tuple[Tensor, Tensor | None, Tensor]:
        """Words (B, L, W), their classes of speech (B, L, P) if P > 0, and how many each sentence has (B,).

        Raises:
            InputError: no sentences, or text that is not valid Unicode.
        """


class TokenWords:
    """Token states of a frozen text encoder as words: what our own evaluator reads.

    Args:
        encoder: any of ``text.encoder.get_text_encoder``.
        most: tokens kept of each sentence, the first ones.
    """

    classes = 0

    def __init__(self, encoder: TextEncoder, most: int = MAX_WORDS) -> None:
        self.encoder, self.most = encoder, most
        self.name, self.width = encoder.name, encoder.dim

    def read(self, captions: Sequence[Said | str]) -> tuple[Tensor, Tensor | None, Tensor]:
        return as_words(
            self.encoder.encode([said if isinstance(said, str) else said.text for said in captions]), self.most
        )


def as_words(embedding: TextEmbedding, most: int) -> tuple[Tensor, None, Tensor]:
    """Encoded sentences in the form of ``Words.read``."""
    lengths_B = embedding.mask.sum(1).clamp_max(most)
    words_BLW = embedding.tokens[:, : int(lengths_B.max())]
    return torch.where(embedding.mask[:, : words_BLW.shape[1], None], words_BLW, 0.0), None, lengths_B
