"""Warns about prompts that are unlike anything the model was trained on, and names the nearest thing it knows."""

import torch

from moveset.pipelines.bundle import Bundle
from moveset.text.encoder import TextEncoder


def unfamiliar(bundle: Bundle, prompts: tuple[str, ...], pooled: torch.Tensor) -> list[str]:
    """One warning for every prompt whose best cosine to the training captions is below ``config.far_prompt``.

    Args:
        bundle: the model, with its captions.
        prompts: S sentences.
        pooled: (S, C) their pooled embeddings.
    """
    captions, known = bundle.captions
    unit = torch.nn.functional.normalize(pooled.float().cpu(), dim=-1)
    best, where = (unit @ known.T).max(dim=-1)
    return [
        f"{prompt!r} is unlike anything this model was trained on (similarity {float(cosine):.2f}); "
        f"the nearest it knows is {captions[k]!r}"
        for prompt, cosine, k in zip(prompts, best, where.tolist(), strict=True)
        if cosine < bundle.config.far_prompt
    ]


def too_long(encoder: TextEncoder, prompts: tuple[str, ...]) -> list[str]:
    """One warning for every prompt whose end the text encoder does not see."""
    counts = [encoder.token_count(prompt) for prompt in prompts]
    return [
        f"the prompt has {count} tokens, of which the text encoder reads {encoder.max_tokens}; its end has no effect"
        for count in counts
        if count > encoder.max_tokens
    ]
