"""Captions as networks read them in training: looked up, and roughened where the corpus has few words."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from moveset.data.paraphrase import paraphrase
from moveset.data.rewordings import reword
from moveset.text.cache import EmbeddingCache
from moveset.text.encoder import TextEmbedding
from moveset.text.live import LiveEmbeddings

MAX_TOKENS = 32


@dataclass(frozen=True, kw_only=True)
class Disturbance:
    """How captions are roughened in training, for corpora of few words; the published methods do none of it.

    Args:
        paraphrased: share of captions said otherwise (``data.paraphrase``).
        reworded: share of captions whose phrases are other ones, each time others (``data.rewordings``). They are
            encoded as they come, and no text cache is made; one that is there is used.
        word_drop: mean share of a sentence's token states that go missing.
        blur: mean standard deviation of the noise on token states (MiniLM's own is 0.38).
    """

    paraphrased: float = 0.0
    reworded: float = 0.0
    word_drop: float = 0.0
    blur: float = 0.0


AS_WRITTEN = Disturbance()


def wordings(captions: Sequence[str], disturbance: Disturbance) -> set[str]:
    """The captions, and their paraphrases where training uses any: what must be in the text cache."""
    said = set(captions)
    return said | {paraphrase(caption) for caption in said if disturbance.paraphrased}


def say(caption: str, disturbance: Disturbance, chance: float, key: int) -> str:
    """The caption as it is said when a number in [0, 1) and a key are drawn."""
    if chance < disturbance.paraphrased:
        return paraphrase(caption)
    if chance < disturbance.paraphrased + disturbance.reworded:
        said = reword(caption, key)
        return paraphrase(said, key) if key % 2 else said
    return caption


def read_captions(
    text: EmbeddingCache | LiveEmbeddings,
    captions: Sequence[str],
    disturbance: Disturbance,
    disturbed_by: torch.Generator | None = None,
) -> TextEmbedding:
    """Token states of captions; "" is the unconditional input.

    Given a generator, words go missing and states are blurred: the corpus has few words, and a network that may rely on
    each of them does not understand a prompt that says the same in others.
    """
    found = text.lookup(captions, MAX_TOKENS)
    if disturbed_by is None:
        return found
    at = disturbed_by.device
    size = torch.rand(len(captions), 1, generator=disturbed_by, device=at)
    missing = torch.rand(found.mask.shape, generator=disturbed_by, device=at) < disturbance.word_drop * 2 * size
    missing[:, 0] = False
    noise = torch.randn(found.tokens.shape, generator=disturbed_by, device=at) * disturbance.blur * 2 * size[..., None]
    empty = torch.tensor([not caption for caption in captions], device=at)
    mask = found.mask & ~(missing & ~empty[:, None]).to(found.mask.device)
    tokens = found.tokens + noise.masked_fill(empty[:, None, None], 0.0).to(found.tokens)
    return TextEmbedding(tokens, mask, found.pooled)
