"""What a user should know about a prompt: that it is unlike the training captions, has words of none, tells of several
people or of what is not done, or is too long."""

from typing import Any

from torch import Tensor

from moveset.pipelines.model_folder import ModelFolder
from moveset.text.encoder import TextEncoder
from moveset.text.vocabulary import denied, several

MOST_WORDS = 4  # of a prompt that are named


def unfamiliar(bundle: ModelFolder[Any], prompts: tuple[str, ...], pooled: Tensor) -> list[str]:
    """A warning for every prompt that is far from all training captions, or near to one and has words of none; and for
    one that tells of several people, or of what is not done.

    Far is a best cosine below ``config.far_prompt``. The nearest caption may well be near and yet another motion ("a
    person is exercising" for riding a bicycle); then words that were in no caption tell.

    Args:
        prompts: S sentences.
        pooled: (S, C) their pooled embeddings.
    """
    known = bundle.captions
    best, where = known.similarity(pooled.cpu())
    out = []
    for prompt, cosine, k in zip(prompts, best.tolist(), where.tolist(), strict=True):
        nearest = f"the nearest it knows is {known.sentences[k]!r}"
        if cosine < bundle.config.far_prompt:
            out.append(f"{prompt!r} is unlike anything this model was trained on (similarity {cosine:.2f}); {nearest}")
        elif words := known.unread(prompt):
            named = ", ".join(map(repr, words[:MOST_WORDS])) + (" …" if len(words) > MOST_WORDS else "")
            them, they = ("words", "they mean") if len(words) > 1 else ("word", "it means")
            out.append(f"this model was never trained on the {them} {named} and guesses what {they}; {nearest}")
        if found := several(prompt):
            out.append(f"this model moves one person alone, not {found!r}; say what that one does")
        if found := denied(prompt):
            out.append(f"this model may do what {found!r} denies; say what is done instead")
    return out


def too_long(encoder: TextEncoder, prompts: tuple[str, ...]) -> list[str]:
    """One warning for every prompt whose end the text encoder does not see."""
    counts = [(prompt, encoder.token_count(prompt)) for prompt in prompts]
    return [
        f"the prompt {beginning(prompt)!r} has {count} tokens, of which the text encoder reads {encoder.max_tokens}; "
        "its end has no effect"
        for prompt, count in counts
        if count > encoder.max_tokens
    ]


def beginning(prompt: str, most: int = 40) -> str:
    """A prompt, cut after ``most`` characters: as much as tells it from others."""
    return f"{prompt[: most - 1]}…" if len(prompt) > most else prompt
