"""How near a prompt is to the captions a model was trained on, the nearest of them, and words it was not trained on.

Shapes: ``K`` known captions, ``P`` width of a pooled embedding.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
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

    def nearest(self, pooled: Tensor) -> tuple[str, float]:
        """The most similar caption to one (P,) pooled embedding, and their cosine."""
        best, where = self.similarity(pooled[None])
        return self.sentences[int(where)], float(best)

    def unread(self, sentence: str) -> tuple[str, ...]:
        """Words of a sentence that were in no caption of the training, in no form (``text.vocabulary.unread``).

        So are numbers in figures where no caption has any, after the words.
        """
        words = unread(sentence, self.words)
        figures = figures_of(sentence) if self.words else []
        if figures and any(map(figures_of, self.sentences)):
            figures = []
        return (*words, *dict.fromkeys(figures))


@dataclass(frozen=True)
class Threshold:
    """A cosine below which a prompt is called unfamiliar, and how that judges the sentences it was made from.

    Args:
        cosine: the threshold.
        false_alarms: share of in-domain sentences below it.
        missed: share of out-of-domain sentences not below it.
    """

    cosine: float
    false_alarms: float
    missed: float


def calibrate(inside: Sequence[float] | Tensor, outside: Sequence[float] | Tensor, *, weight: float = 2.0) -> Threshold:
    """The threshold with the least ``weight * false_alarms + missed``, midway in its gap.

    Args:
        inside: best cosines (``KnownPrompts.similarity``) of sentences about what the model knows, without themselves.
        outside: the same for sentences about things it does not know.
        weight: how much worse a needless warning is than a missing one.

    Raises:
        InputError: no sentences on one side.

    >>> calibrate([0.7, 0.9, 0.8], [0.2, 0.5])
    Threshold(cosine=0.6, false_alarms=0.0, missed=0.0)
    """
    low, high = (torch.as_tensor(x, dtype=torch.float64).sort().values for x in (inside, outside))
    if not len(low) or not len(high):
        raise InputError("calibration needs sentences on both sides; give some inside and some outside the domain")
    values = torch.cat((low, high)).unique()
    edges = torch.cat((values[:1] - 1, values, values[-1:] + 1))
    cuts = (edges[:-1] + edges[1:]) / 2
    alarms = torch.searchsorted(low, cuts).double() / len(low)
    missed = 1 - torch.searchsorted(high, cuts).double() / len(high)
    best = int((weight * alarms + missed).argmin())
    return Threshold(round(float(cuts[best]), 6), float(alarms[best]), float(missed[best]))
