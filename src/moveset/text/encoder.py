"""What a text encoder is: sentences in, token states out.

Shapes: ``B`` sentences, ``L`` tokens of the longest one, ``C`` width of the encoder.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from moveset.errors import InputError


@dataclass(frozen=True, eq=False)
class TextEmbedding:
    """Encoded sentences.

    Args:
        tokens: (B, L, C) float32 token states; zero where there is no token.
        mask: (B, L) bool, True where there is a token. Every row has at least one.
        pooled: (B, P) float32, one unit vector per sentence; P = C for MiniLM and T5, a projection's width otherwise.
    """

    tokens: Tensor
    mask: Tensor
    pooled: Tensor

    def __len__(self) -> int:
        return len(self.pooled)

    def __getitem__(self, rows: slice | Tensor) -> "TextEmbedding":
        """Some of the sentences; the padding stays as wide as it was."""
        return TextEmbedding(self.tokens[rows], self.mask[rows], self.pooled[rows])

    def first(self, count: int) -> "TextEmbedding":
        """The first tokens of each sentence; what comes after them is not read."""
        return TextEmbedding(self.tokens[:, :count], self.mask[:, :count], self.pooled)

    def to(self, device: torch.device | str) -> "TextEmbedding":
        return TextEmbedding(self.tokens.to(device), self.mask.to(device), self.pooled.to(device))


class TextEncoder(Protocol):
    """A frozen text encoder.

    ``name`` identifies it in caches and checkpoints, ``dim`` is C, and sentences are cut after ``max_tokens`` tokens
    (special tokens included). It computes on ``device``, and its results lie there. The empty sentence is legal: it is
    the unconditional input of guided diffusion.
    """

    name: str
    dim: int
    max_tokens: int
    device: torch.device

    def encode(self, sentences: Sequence[str]) -> TextEmbedding:
        """Encode one or more sentences. Raises InputError for none at all or for text that is not valid Unicode."""
        ...

    def token_count(self, sentence: str) -> int:
        """Tokens of the whole sentence before any cut: more than ``max_tokens`` means that its end is not seen."""
        ...


def check_sentences(sentences: Sequence[str]) -> list[str]:
    """The sentences as a list.

    Raises:
        InputError: no sentence, or one with code points that no UTF-8 text can hold (a badly decoded command line).
    """
    if isinstance(sentences, str) or not sentences:
        raise InputError(
            f"an encoder needs a list of at least one sentence, not {sentences!r}; give ['a person walks']"
        )
    for sentence in sentences:
        try:
            sentence.encode()
        except UnicodeEncodeError:
            raise InputError(f"the text {sentence!r} is not valid Unicode; give it as UTF-8") from None
    return list(sentences)


def stack(embeddings: Sequence[TextEmbedding]) -> TextEmbedding:
    """Join batches into one, padded to the longest."""
    width = max(e.tokens.shape[1] for e in embeddings)
    pad = torch.nn.functional.pad
    return TextEmbedding(
        torch.cat([pad(e.tokens, (0, 0, 0, width - e.tokens.shape[1])) for e in embeddings]),
        torch.cat([pad(e.mask, (0, width - e.mask.shape[1])) for e in embeddings]),
        torch.cat([e.pooled for e in embeddings]),
    )


def get_text_encoder(name: str = "minilm", *, device: torch.device | str = "cpu") -> TextEncoder:
    """An encoder by name: "minilm" (packaged, offline), "clip:WHERE", "t5:WHERE" or "sentence-t5:WHERE".

    WHERE is a Hugging Face model id that is already on disk, or a local folder (see ``moveset.text.hub``).

    Raises:
        InputError: an unknown name, or a model that is not on this machine.
    """
    if name == "minilm":
        from moveset.text.minilm import MiniLM

        return MiniLM(device=device)
    family, _, where = name.partition(":")
    if family in ("clip", "t5", "sentence-t5") and where:
        from moveset.text import hub

        kinds = {"clip": hub.ClipText, "t5": hub.T5Text, "sentence-t5": hub.SentenceT5}
        return kinds[family](where, device=device)
    raise InputError(f"text encoder {name!r} is unknown; use 'minilm', 'clip:MODEL', 't5:MODEL' or 'sentence-t5:MODEL'")
