"""How captions are roughened in training: for data of few words."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class TextAugmentation:
    """How captions are roughened in training, for corpora of few words; the published methods do none of it.

    Args:
        token_dropout: mean share of a sentence's token states that go missing.
        embedding_noise: mean standard deviation of the noise on token states (MiniLM's own is 0.38).
    """

    token_dropout: float = 0.0
    embedding_noise: float = 0.0
