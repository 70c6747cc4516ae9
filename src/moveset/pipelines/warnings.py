"""What a user should know about a prompt: that it is unlike the training captions, has other words, tells of more than
one person or of more stages than can be done at a time, or is longer than can be read.
"""

import re
from typing import Any

from torch import Tensor

from moveset.pipelines.model_folder import ModelFolder
from moveset.pipelines.reading import read
from moveset.text.encoder import TextEncoder
from moveset.text.familiarity import KnownPrompts
from moveset.text.stages import split_stages

MOST_WORDS = 4  # of a prompt that are named
_STAGES = 2  # one after the other in the captions of the training, whose composed ones are not kept
_SEVERAL = re.compile(
    r"\b(?:people|persons|men|women|children|kids|boys|girls|guys|ladies|gentlemen|couple|crowd|each\s+other"
    r"|one\s+another)\b(?!['’])",
    re.I,
)


def unfamiliar(bundle: ModelFolder[Any], prompts: tuple[str, ...], pooled: Tensor) -> list[str]:
    """Warnings for every prompt that asks for what the model was not trained on.

    One that is far from all training captions gets one: its best cosine is below ``config.far_prompt``. The nearest
    caption may well be near and yet another motion ("a person is exercising" for riding a bicycle); then words that
    were in no caption tell, or that there are several persons, or more than two things to do one after the other. Words
    that are read as others (``synonyms``) get one that says as which, and no other.

    Args:
        bundle: the model, with its captions.
        prompts: S sentences.
        pooled: (S, C) their pooled embeddings.
    """
    known = bundle.captions
    best, where = known.similarity(pooled.cpu())
    out = []
    for prompt, cosine, k in zip(prompts, best.tolist(), where.tolist(), strict=True):
        nearest = f"the nearest it knows is {known.sentences[k]!r}"
        read_as = read(prompt, known)
        if read_as.replaced:
            named = ", ".join(f"{word!r} as {by!r}" for word, by in read_as.replaced[:MOST_WORDS])
            more = " …" if len(read_as.replaced) > MOST_WORDS else ""
            out.append(f"words that this model was never trained on are read as others: {named}{more}")
        for bend in read_as.bent:
            out.append(f"this model was never trained on {bend.said!r}: {bend.steering.says}")
        if cosine < bundle.config.far_prompt:
            out.append(f"{prompt!r} is unlike anything this model was trained on (similarity {cosine:.2f}); {nearest}")
            continue
        if words := known.unread(read_as.text):
            named = ", ".join(map(repr, words[:MOST_WORDS])) + (" …" if len(words) > MOST_WORDS else "")
            them, they = ("words", "they mean") if len(words) > 1 else ("word", "it means")
            out.append(f"this model was never trained on the {them} {named} and guesses what {they}; {nearest}")
        elif pairs := known.unpaired(read_as.text):
            named = " or ".join(map(repr, pairs))
            out.append(f"this model knows the words of {named} but was never trained on that; {nearest}")
        if found := _SEVERAL.search(prompt):
            out.append(f"this model moves one person alone, not {found.group()!r}; {nearest}")
        if (count := len(split_stages(prompt))) > _STAGES and count > _most_stages(known):
            out.append(f"{prompt!r} says {count} things one after the other, more than this model learned to do at a "
                       "time; give each as a prompt of its own")  # fmt: skip
    return out


def _most_stages(known: KnownPrompts) -> int:
    return max(len(split_stages(sentence)) for sentence in known.sentences)


def too_long(encoder: TextEncoder, prompts: tuple[str, ...], known: KnownPrompts) -> list[str]:
    """One warning for every prompt whose end, as it is read, the text encoder does not see."""
    counts = [encoder.token_count(read(prompt, known).text) for prompt in prompts]
    return [
        f"the prompt has {count} tokens, of which the text encoder reads {encoder.max_tokens}; its end has no effect"
        for count in counts
        if count > encoder.max_tokens
    ]
