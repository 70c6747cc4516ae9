"""Embeddings of any sentence: looked up where a cache holds it, encoded where it does not.

For trainings whose captions are said in more ways than a file could hold. Shapes: ``B`` sentences, ``L`` tokens of the
longest, ``C`` width of a token, ``P`` of a pooled sentence.
"""

from collections.abc import Sequence

import torch
from torch import Tensor

from moveset.text.cache import EmbeddingCache
from moveset.text.encoder import TextEmbedding, TextEncoder


class LiveEmbeddings:
    """Stands where an ``EmbeddingCache`` stands; its results lie on the encoder's device, rounded to half precision as
    a cache's are.

    Args:
        encoder: for what the cache lacks.
        cache: on the encoder's device; None where there is none.
    """

    def __init__(self, encoder: TextEncoder, cache: EmbeddingCache | None = None) -> None:
        self.encoder, self.cache = encoder, cache
        empty = self._encode([""])
        self.widths = (empty.tokens.shape[2], empty.pooled.shape[1])
        self._rows: dict[str, int] = {}
        self._prepared = empty

    def prepare(self, sentences: Sequence[str]) -> None:
        """Encode at once what the next lookups will ask for, instead of what was prepared before.

        Whatever is looked up without is encoded too, so that results do not depend on what came before.
        """
        missing = self._unknown(["", *sentences], prepared=False)
        if missing:
            self._prepared = self._encode(missing)
        self._rows = {sentence: row for row, sentence in enumerate(missing)}

    def lookup(self, sentences: Sequence[str], max_tokens: int | None = None) -> TextEmbedding:
        """Embeddings of some sentences, padded to the longest of them; arguments as for ``EmbeddingCache.lookup``."""
        groups = self._by_origin(sentences, max_tokens)
        length = max(int(found.mask.sum(dim=1).max()) for _, found in groups)
        if max_tokens is not None:
            length = min(length, max_tokens)
        places, found = zip(*groups, strict=True)
        order = torch.cat(places).argsort()
        tokens, mask = (
            torch.cat([_to_length(getattr(f, name), length) for f in found])[order] for name in ("tokens", "mask")
        )
        return TextEmbedding(tokens, mask, torch.cat([f.pooled for f in found])[order])

    def pooled_of(self, sentences: Sequence[str]) -> Tensor:
        """Sentence embeddings (B, P)."""
        return self.lookup(sentences, max_tokens=1).pooled

    def _by_origin(self, sentences: Sequence[str], max_tokens: int | None) -> list[tuple[Tensor, TextEmbedding]]:
        """Which sentences come from the cache, from what was prepared, and from the encoder now."""
        at = self._prepared.pooled.device
        known = set() if self.cache is None else {s for s in sentences if s in self.cache}
        missing = self._unknown(sentences)
        fresh = {sentence: row for row, sentence in enumerate(missing)}
        origin = [0 if s in known else 2 if s in fresh else 1 for s in sentences]
        groups = []
        for kind in sorted(set(origin)):
            places = [k for k, o in enumerate(origin) if o == kind]
            said = [sentences[k] for k in places]
            if kind == 0 and self.cache is not None:
                found = self.cache.lookup(said, max_tokens)
            else:
                rows, of = (fresh, self._encode(missing)) if kind == 2 else (self._rows, self._prepared)
                found = of[torch.tensor([rows[s] for s in said], device=at)]
            groups.append((torch.tensor(places, device=at), found))
        return groups

    def _unknown(self, sentences: Sequence[str], prepared: bool = True) -> list[str]:
        """Those that neither the cache holds nor, if that counts, was prepared, each once."""
        rows = self._rows if prepared else {}
        return [s for s in dict.fromkeys(sentences) if s not in rows and (self.cache is None or s not in self.cache)]

    def _encode(self, sentences: Sequence[str]) -> TextEmbedding:
        with torch.autocast(self.encoder.device.type, enabled=False):
            found = self.encoder.encode(sentences)
        return TextEmbedding(found.tokens.half().float(), found.mask, found.pooled.half().float())


def _to_length(x_BL: Tensor, length: int) -> Tensor:
    """Tokens or a mask, (B, L) or (B, L, C), cut or padded with zeros to a length."""
    x_BL = x_BL[:, :length]
    padded = x_BL.new_zeros(len(x_BL), length, *x_BL.shape[2:])
    padded[:, : x_BL.shape[1]] = x_BL
    return padded
