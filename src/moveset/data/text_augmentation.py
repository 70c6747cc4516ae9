"""How captions are said otherwise, and roughened, in training: for data of few words."""

from collections.abc import Sequence
from dataclasses import dataclass

from moveset.data.paraphrase import paraphrase
from moveset.data.rewordings import reword


@dataclass(frozen=True, kw_only=True)
class TextAugmentation:
    """How captions are roughened in training, for corpora of few words; the published methods do none of it.

    Args:
        paraphrased: share of captions said otherwise (``data.paraphrase``).
        reworded: share of captions whose phrases are other ones, each time others (``data.rewordings``). They are
            encoded as they come, and no text cache is made; one that is there is used.
        token_dropout: mean share of a sentence's token states that go missing.
        embedding_noise: mean standard deviation of the noise on token states (MiniLM's own is 0.38).
    """

    paraphrased: float = 0.0
    reworded: float = 0.0
    token_dropout: float = 0.0
    embedding_noise: float = 0.0


AS_WRITTEN = TextAugmentation()


def wordings(captions: Sequence[str], augmentation: TextAugmentation) -> set[str]:
    """The captions, and their paraphrases where training uses any: what must be in the text cache."""
    said = set(captions)
    return said | {paraphrase(caption) for caption in said if augmentation.paraphrased}


def say(options: Sequence[str], augmentation: TextAugmentation, pick: float, chance: float) -> str:
    """One of the captions as it is said, by two numbers in [0, 1): which one, and whether otherwise."""
    place = pick * len(options)
    caption = options[int(place)]
    if chance < augmentation.paraphrased:
        return paraphrase(caption)
    if chance < augmentation.paraphrased + augmentation.reworded:
        # What chooses the caption has digits left to choose a wording of it.
        key = int(place % 1 * 2**16)
        said = reword(caption, key)
        return paraphrase(said, key) if key % 2 else said
    return caption
