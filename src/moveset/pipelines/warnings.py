"""What a user should know about a prompt: that it is unlike the training captions, or longer than can be read."""

from typing import Any

from torch import Tensor

from moveset.pipelines.model_folder import ModelFolder
from moveset.text.encoder import TextEncoder


def unfamiliar(bundle: ModelFolder[Any], prompts: tuple[str, ...], pooled: Tensor) -> list[str]:
    """One warning for every prompt whose best cosine to the training captions is below ``config.far_prompt``.

    Args:
        bundle: the model, with its captions.
        prompts: S sentences.
        pooled: (S, C) their pooled embeddings.
    """
    best, where = bundle.captions.similarity(pooled.cpu())
    return [
        f"{prompt!r} is unlike anything this model was trained on (similarity {float(cosine):.2f}); "
        f"the nearest it knows is {bundle.captions.sentences[k]!r}"
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
