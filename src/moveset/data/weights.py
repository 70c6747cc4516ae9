"""How often a corpus' clips are drawn in training."""

from collections import Counter
from collections.abc import Sequence

import torch
from torch import Tensor

from moveset.data.corpus import Corpus

_SIDED = 2.0  # times as often
_DOWN = 3.0
_LOW = 0.45  # metres over the floor that the root is below where somebody lies, crawls, kneels or falls


def corpus_weights(corpus: Corpus, records: Sequence[int], power: float, composed_share: float) -> Tensor:
    """Sampling weights of records: what they show first by count^(1 - power), compositions ``composed_share`` in all,
    where there are takes, too.

    Takes that are long and alike have less weight of their own, and those whose sentences name a side have more: people
    who describe motion seldom do, and which hand it was is learned of nothing else. So do those in which somebody is
    down: they are few, and where the floor is cannot be learned from who walks.
    """
    chosen = [corpus.records[k] for k in records]
    counts = Counter(record.contents[:1] for record in chosen)
    each = [
        record.weight
        * counts[record.contents[:1]] ** -power
        * (_SIDED if corpus.captions(k) != corpus.captions(k, mirrored=True) else 1.0)
        * (_DOWN if corpus.lowest(k) < _LOW else 1.0)
        for k, record in zip(records, chosen, strict=True)
    ]
    weights = torch.tensor(each, dtype=torch.float64)
    composed = torch.tensor([record.kind not in ("take", "paced") for record in chosen])
    if composed.any() and not composed.all():
        for part, share in ((composed, composed_share), (~composed, 1.0 - composed_share)):
            weights[part] *= share / weights[part].sum()
    return weights
