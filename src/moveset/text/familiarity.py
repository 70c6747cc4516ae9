"""How near a prompt is to the captions a model was trained on, the nearest of them, and words it was not trained on.

Shapes: ``K`` known captions, ``P`` width of a pooled embedding.
"""

from dataclasses import dataclass

from torch import Tensor
from torch.nn.functional import normalize

from moveset.errors import InputError
from moveset.text.vocabulary import figures_of, unread


@dataclass(frozen=True, eq=False)
class KnownPrompts:
    """Captions and their pooled embeddings.

    Args:
        sentences: K captions.
        pooled: (K, P), float16 or float32.
        words: of all captions of the training, these among them; empty if nobody wrote them down.

    Raises:
        InputError: no captions, or numbers that do not belong together.
    """

    sentences: tuple[str, ...]
    pooled: Tensor
    words: frozenset[str] = frozenset()

    def __post_init__(self) -> None:
        if not self.sentences or self.pooled.ndim != 2 or len(self.pooled) != len(self.sentences):
            raise InputError(
                f"{len(self.sentences)} captions and embeddings {tuple(self.pooled.shape)} do not belong together; "
                "give one row for every caption"
            )
        object.__setattr__(self, "pooled", normalize(self.pooled.float(), dim=-1))

    def similarity(self, pooled: Tensor) -> tuple[Tensor, Tensor]:
        """(B,) best cosine and (B,) index of that caption, for (B, P) pooled embeddings."""
        best_B, where_B = (normalize(pooled.float(), dim=-1) @ self.pooled.T).max(dim=-1)
        return best_B, where_B

    def unread(self, sentence: str) -> tuple[str, ...]:
        """Words of a sentence that were in no caption of the training, in no form (``text.vocabulary.unread``).

        So are numbers in figures where no caption has any, after the words.
        """
        words = unread(sentence, self.words)
        figures = figures_of(sentence) if self.words else []
        if figures and any(map(figures_of, self.sentences)):
            figures = []
        return (*words, *dict.fromkeys(figures))
