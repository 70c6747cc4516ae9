"""Captions as networks read them in training: looked up, and roughened where the corpus has few words."""

from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

import torch
from torch import Tensor

from moveset.data.text_augmentation import TextAugmentation
from moveset.text.cache import EmbeddingCache, cache_file
from moveset.text.encoder import TextEmbedding, get_text_encoder
from moveset.text.sides import forget

T = TypeVar("T")


def embedded(folder: Path, encoder: str, captions: Sequence[str], device: torch.device | str = "cpu") -> EmbeddingCache:
    """Embeddings of captions, from a training's text cache, to which those it lacks are added.

    Args:
        folder: where the cache is kept.
        encoder: its name, as for ``get_text_encoder``.
        device: where they are encoded, and looked up.

    Raises:
        InputError: an encoder that is not here.
    """
    encode = get_text_encoder(encoder, device=device)
    return EmbeddingCache.build(encode, sorted({*captions}), cache_file(folder, encoder)).to(device)


def read_captions(
    text: EmbeddingCache,
    captions: Sequence[str],
    augmentation: TextAugmentation,
    augmented_by: torch.Generator | None = None,
) -> TextEmbedding:
    """Token states of captions; "" is the unconditional input.

    Given a generator, words go missing and states are blurred: the corpus has few words, and a network that may rely on
    each of them does not understand a prompt that says the same in others.
    """
    found = text.lookup(captions)
    if augmented_by is None:
        return found
    at = augmented_by.device
    size = torch.rand(len(captions), 1, generator=augmented_by, device=at)
    missing = torch.rand(found.mask.shape, generator=augmented_by, device=at) < augmentation.token_dropout * 2 * size
    missing[:, 0] = False
    deviation = augmentation.embedding_noise * 2 * size[..., None]
    noise = torch.randn(found.tokens.shape, generator=augmented_by, device=at) * deviation
    empty = torch.tensor([not caption for caption in captions], device=at)
    mask = found.mask & ~(missing & ~empty[:, None]).to(found.mask.device)
    tokens = found.tokens + noise.masked_fill(empty[:, None, None], 0.0).to(found.tokens)
    return TextEmbedding(tokens, mask, found.pooled)


def told_sides(captions: Sequence[str], sides_B3: Tensor, share: float, generator: torch.Generator) -> Tensor:
    """(B, 3) sides that are said beside ``share`` of the captions, NaN for what is not; beside "", the unconditional
    input, there is nothing."""
    silent = torch.tensor([not caption for caption in captions], device=sides_B3.device)
    return forget(sides_B3, 1 - share, generator).masked_fill(silent[:, None], torch.nan)


def draw_told(pairs: Sequence[tuple[tuple[str, ...], T]], size: int, seed: int, step: int) -> tuple[list[str], list[T]]:
    """A step's sentences, one of each drawn clip's, and what is known of these clips; pure in (seed, step)."""
    generator = torch.Generator().manual_seed(seed * 1_000_003 + step)
    drawn = [pairs[row] for row in torch.randint(len(pairs), (size,), generator=generator).tolist()]
    pick = torch.rand(size, generator=generator).tolist()
    said = [texts[int(place * len(texts))] for (texts, _), place in zip(drawn, pick, strict=True)]
    return said, [known for _, known in drawn]
