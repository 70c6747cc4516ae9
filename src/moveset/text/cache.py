"""Sentences encoded once: kept in one file and looked up in batches during training, or kept in memory.

Shapes: ``K`` cached sentences, ``T`` tokens of all of them, ``B`` looked-up rows, ``L`` tokens of the longest row,
``C`` width of a token, ``P`` of a pooled sentence.
"""

import hashlib
import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from moveset.errors import FormatError, InputError
from moveset.io.limits import atomic_write
from moveset.io.process import locked
from moveset.text.encoder import TextEmbedding, TextEncoder, check_sentences, stack

_FORMAT = "moveset text cache 1"
_TENSORS = {"tokens": (torch.float16, 2), "pooled": (torch.float16, 2), "offsets": (torch.int64, 1)}


def cache_file(folder: Path, encoder: str) -> Path:
    """The file of an encoder's sentences in a folder; names of encoders may be paths.

    >>> cache_file(Path("cache"), "clip:openai/clip-vit-base-patch32").name
    'text-clip-openai-clip-vit-base-patch32.safetensors'
    """
    return folder / f"text-{encoder.replace('/', '-').replace(':', '-')}.safetensors"


@dataclass(frozen=True, eq=False)
class EmbeddingCache:
    """Token states of K different sentences in half precision.

    Row 0 is always the empty sentence, so dropping the text of some items is ``torch.where(dropped, 0, rows)``.

    Args:
        encoder: name of the encoder, and ``max_tokens`` its limit.
        sentences: K different sentences; ``sentences[0] == ""``.
        tokens: (T, C) float16, the sentences' token states one after the other.
        pooled: (K, P) float16.
        offsets: (K + 1,) int64; sentence k owns ``tokens[offsets[k]:offsets[k + 1]]``.
    """

    encoder: str
    max_tokens: int
    sentences: tuple[str, ...]
    tokens: Tensor
    pooled: Tensor
    offsets: Tensor

    def __len__(self) -> int:
        return len(self.sentences)

    @classmethod
    def build(cls, encoder: TextEncoder, sentences: Sequence[str], path: str | Path) -> "EmbeddingCache":
        """Encode those of ``sentences`` that the file at ``path`` does not hold yet, and add them to it.

        Raises:
            InputError: no sentences, or a path that cannot be written.
        """
        path = Path(path)
        wanted = tuple(dict.fromkeys(["", *check_sentences(sentences)]))
        found = cls._usable(path, encoder)
        if found is not None and all(sentence in found for sentence in wanted):
            return found
        # Of two processes that add to it at once the second adds to what the first has written.
        with locked(path.parent):
            found = cls._usable(path, encoder)
            wanted = tuple(sentence for sentence in wanted if found is None or sentence not in found)
            if found is not None and not wanted:
                return found
            states, pooled = _encode_all(encoder, wanted)
            offsets = torch.tensor([0, *(len(s) for s in states)]).cumsum(0)
            cache = cls(encoder.name, encoder.max_tokens, wanted, torch.cat(states), pooled, offsets)
            (cache if found is None else found._with(cache))._write(path)
            return cls.open(path)

    @classmethod
    def open(cls, path: str | Path) -> "EmbeddingCache":
        """Read a cache and verify it: structure and checksum.

        Raises:
            InputError: the file is missing.
            FormatError: it is damaged or not a cache.
        """
        path = Path(path)
        if not path.is_file():
            raise InputError(f"there is no text cache {path}; build it with EmbeddingCache.build")
        try:
            with safe_open(path, framework="pt") as file:
                meta = file.metadata() or {}
                tensors = {name: file.get_tensor(name) for name in _TENSORS}
                names = file.get_tensor("sentences").numpy().tobytes()
            sentences = tuple(json.loads(names))
            cache = cls(meta["encoder"], int(meta["max_tokens"]), sentences, **tensors)
            sound = meta["format"] == _FORMAT and cache._well_formed() and meta["sha256"] == cache._digest()
        except (SafetensorError, KeyError, ValueError, TypeError) as error:
            raise FormatError(f"{path} is not a text cache ({error}); delete it and build it again") from None
        if not sound:
            raise FormatError(f"the text cache {path} is damaged; delete it and build it again")
        return cache

    def __contains__(self, sentence: str) -> bool:
        return sentence in self._row_of

    @property
    def widths(self) -> tuple[int, int]:
        """C and P."""
        return self.tokens.shape[1], self.pooled.shape[1]

    def to(self, device: torch.device | str) -> "EmbeddingCache":
        """The same with its tensors on another device; lookups then happen there."""
        return replace(self, **{name: getattr(self, name).to(device) for name in _TENSORS})

    def rows(self, sentences: Sequence[str]) -> Tensor:
        """(B,) row numbers of sentences. Raises InputError for one that is not in the cache."""
        try:
            found = [self._row_of[sentence] for sentence in sentences]
        except KeyError as error:
            raise InputError(
                f"the sentence {error.args[0]!r} is not among the {len(self)} in the text cache; build it again"
            ) from None
        return torch.tensor(found, device=self.offsets.device)

    def lookup(self, sentences: Sequence[str], max_tokens: int | None = None) -> TextEmbedding:
        """Embeddings of B sentences, padded to the longest of them.

        Args:
            max_tokens: keep at most this many tokens of each, the first ones.

        Raises:
            InputError: a sentence that is not in the cache.
        """
        rows_B = self.rows(sentences)
        start_B = self.offsets[rows_B]
        count_B = self.offsets[rows_B + 1] - start_B
        if max_tokens is not None:
            count_B = count_B.clamp(max=max_tokens)
        place_L = torch.arange(int(count_B.max()), device=rows_B.device)
        mask_BL = place_L < count_B[:, None]
        # Padding reads the row's first token and is then zeroed: no index leaves the table.
        where_BL = start_B[:, None] + place_L * mask_BL
        tokens_BLC = self.tokens[where_BL].float() * mask_BL[:, :, None]
        return TextEmbedding(tokens_BLC, mask_BL, self.pooled[rows_B].float())

    def pooled_of(self, sentences: Sequence[str]) -> Tensor:
        """(B, P) pooled sentences, without looking up their tokens; errors as of ``rows``."""
        return self.pooled[self.rows(sentences)].float()

    @cached_property
    def _row_of(self) -> dict[str, int]:
        return {sentence: row for row, sentence in enumerate(self.sentences)}

    @classmethod
    def _usable(cls, path: Path, encoder: TextEncoder) -> "EmbeddingCache | None":
        """What a file holds of this encoder; None if it is missing, damaged, of an older version or of another one."""
        try:
            found = cls.open(path)
        except (InputError, FormatError):
            return None
        return found if (found.encoder, found.max_tokens) == (encoder.name, encoder.max_tokens) else None

    def _with(self, more: "EmbeddingCache") -> "EmbeddingCache":
        """The sentences of both, of which none is in both."""
        tokens, pooled = (torch.cat((getattr(self, name), getattr(more, name))) for name in ("tokens", "pooled"))
        offsets = torch.cat((self.offsets, self.offsets[-1] + more.offsets[1:]))
        return EmbeddingCache(self.encoder, self.max_tokens, self.sentences + more.sentences, tokens, pooled, offsets)

    def _well_formed(self) -> bool:
        shapes = all((getattr(self, n).dtype, getattr(self, n).ndim) == want for n, want in _TENSORS.items())
        counts = self.offsets.shape == (len(self) + 1,) and len(self.pooled) == len(self)
        texts = all(isinstance(s, str) for s in self.sentences) and len(self._row_of) == len(self)
        if not (shapes and counts and texts and self.sentences[:1] == ("",)):
            return False
        lengths = self.offsets.diff()
        return int(self.offsets[0]) == 0 and int(self.offsets[-1]) == len(self.tokens) and bool((lengths > 0).all())

    def _digest(self) -> str:
        digest = hashlib.sha256(json.dumps([_FORMAT, self.encoder, self.max_tokens, self.sentences]).encode())
        for name in _TENSORS:
            digest.update(getattr(self, name).contiguous().numpy())
        return digest.hexdigest()

    def _write(self, path: Path) -> None:
        names = bytearray(json.dumps(self.sentences).encode())
        tensors = {name: getattr(self, name).contiguous() for name in _TENSORS}
        tensors["sentences"] = torch.frombuffer(names, dtype=torch.uint8)
        meta = {"format": _FORMAT, "encoder": self.encoder, "max_tokens": str(self.max_tokens)}
        with atomic_write(path) as file:
            file.write(save(tensors, metadata={**meta, "sha256": self._digest()}))


class CachedEncoder:
    """A text encoder that keeps what it encoded last; may be used by several threads.

    Every sentence is encoded alone: the same numbers whatever else is asked for.

    Args:
        limit: how many sentences are kept; one takes at most a tenth of a megabyte.
    """

    def __init__(self, encoder: TextEncoder, limit: int = 64) -> None:
        self._encoder = encoder
        self.name, self.dim = encoder.name, encoder.dim
        self.max_tokens, self.device = encoder.max_tokens, encoder.device
        self._one = lru_cache(limit)(lambda sentence: encoder.encode([sentence]))

    def encode(self, sentences: Sequence[str]) -> TextEmbedding:
        """As the encoder's own."""
        found = [self._one(sentence) for sentence in check_sentences(sentences)]
        return found[0] if len(found) == 1 else stack(found)

    def token_count(self, sentence: str) -> int:
        """As the encoder's own."""
        return self._encoder.token_count(sentence)


def _encode_all(encoder: TextEncoder, sentences: Sequence[str], batch: int = 64) -> tuple[list[Tensor], Tensor]:
    """Token states (one tensor per sentence) and pooled vectors (K, P), in half precision."""
    from tqdm import tqdm

    # Sentences of like length share a batch, so that little padding is computed.
    order = sorted(range(len(sentences)), key=lambda k: len(sentences[k]))
    states: list[Tensor] = [torch.empty(0)] * len(sentences)
    pooled: list[Tensor] = [torch.empty(0)] * len(sentences)
    for first in tqdm(range(0, len(order), batch), desc="text", unit="batch", disable=None):
        rows = order[first : first + batch]
        coded = encoder.encode([sentences[k] for k in rows]).to("cpu")
        for n, k in enumerate(rows):
            states[k] = coded.tokens[n, coded.mask[n]].half()
            pooled[k] = coded.pooled[n].half()
    return states, torch.stack(pooled)
