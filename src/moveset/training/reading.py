"""Captions as networks read them in training: looked up, and roughened where the corpus has few words."""

from collections.abc import Sequence
from pathlib import Path

import torch

from moveset.data.text_augmentation import TextAugmentation, wordings
from moveset.errors import InputError
from moveset.text.cache import EmbeddingCache, cache_file
from moveset.text.encoder import TextEmbedding, get_text_encoder
from moveset.text.live import LiveEmbeddings

MAX_TOKENS = 32


def open_text(
    folder: Path,
    encoder: str,
    captions: Sequence[str],
    others: Sequence[str],
    augmentation: TextAugmentation,
    device: torch.device,
) -> EmbeddingCache | LiveEmbeddings:
    """What captions of a training are looked up in, on a device.

    Args:
        folder: where the text cache is kept, which is made or added to if it may have to hold something new.
        encoder: its name, as for ``get_text_encoder``.
        captions: of training, which are disturbed, and ``others``, which are not.

    Raises:
        InputError: shares of captions that add up to more than all of them, or an encoder that is not here.
    """
    if augmentation.paraphrased + augmentation.reworded > 1.0:
        raise InputError(
            f"augmentation.paraphrased={augmentation.paraphrased:g} and "
            f"augmentation.reworded={augmentation.reworded:g} are shares of the same captions; give no more than 1 "
            "together"
        )
    path = cache_file(folder, encoder)
    if augmentation.reworded:
        live = get_text_encoder(encoder, device=device)
        held = EmbeddingCache.open(path, encoder=live.name).to(device) if path.is_file() else None
        return LiveEmbeddings(live, held)
    return embedded(folder, encoder, sorted({*wordings(captions, augmentation), *others})).to(device)


def embedded(folder: Path, encoder: str, captions: Sequence[str]) -> EmbeddingCache:
    """Captions as they are, from a training's text cache, or added to it: a training that rewords leaves none."""
    return EmbeddingCache.build(get_text_encoder(encoder), captions, cache_file(folder, encoder))


def read_captions(
    text: EmbeddingCache | LiveEmbeddings,
    captions: Sequence[str],
    augmentation: TextAugmentation,
    augmented_by: torch.Generator | None = None,
) -> TextEmbedding:
    """Token states of captions; "" is the unconditional input.

    Given a generator, words go missing and states are blurred: the corpus has few words, and a network that may rely on
    each of them does not understand a prompt that says the same in others.
    """
    found = text.lookup(captions, MAX_TOKENS)
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
