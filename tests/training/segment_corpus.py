"""A synthetic corpus, and a text encoder that takes no time, for training tests of segments."""

from collections.abc import Sequence
from pathlib import Path

import pytest
import torch

from moveset.data.synthetic import synthetic_corpus
from moveset.text.encoder import TextEmbedding
from moveset.training import reading


class Words:
    """Every word is a token, a random vector of its own; a sentence is their mean. "" is one token."""

    name, dim, max_tokens, device = "words", 8, 16, torch.device("cpu")

    def token_count(self, sentence: str) -> int:
        return len(sentence.split()) or 1

    def encode(self, sentences: Sequence[str]) -> TextEmbedding:
        said = [(sentence.split() or [""])[: self.max_tokens] for sentence in sentences]
        longest = max(len(words) for words in said)
        tokens, mask = torch.zeros(len(said), longest, self.dim), torch.zeros(len(said), longest, dtype=torch.bool)
        for k, words in enumerate(said):
            for place, word in enumerate(words):
                seed = int.from_bytes(word.encode()[:7], "little")
                tokens[k, place] = torch.randn(self.dim, generator=torch.Generator().manual_seed(seed))
            mask[k, : len(words)] = True
        pooled = tokens.sum(1) / mask.sum(1, keepdim=True)
        return TextEmbedding(tokens, mask, torch.nn.functional.normalize(pooled, dim=-1))


def use_words(patch: pytest.MonkeyPatch) -> None:
    """Recurrent trainings then read captions by ``Words``."""
    patch.setattr(reading, "get_text_encoder", lambda name, device="cpu": Words())


def write_corpus(folder: Path) -> Path:
    """Twenty-four takes and their compositions."""
    return synthetic_corpus(folder / "corpus.safetensors", clips=24, seed=0)
