"""all-MiniLM-L6-v2 as a six-layer BERT forward in plain torch: offline, quick to load, equal to ``transformers``.

MiniLM: Wang et al. 2020, arXiv 2002.10957; BERT: Devlin et al. 2018, arXiv 1810.04805. The weights are those of
``sentence-transformers/all-MiniLM-L6-v2``, rounded to 8 bits by ``benchmarks/text_encoder.py`` and computed with in
single precision. Sentences are pooled as Sentence-BERT does (arXiv 1908.10084): mean over tokens, unit length.

Shapes: ``B`` sentences, ``L`` tokens, ``C`` = 384 width, ``H`` = 12 heads.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError, safe_open
from tokenizers import Tokenizer
from torch import Tensor
from torch.nn.functional import layer_norm, normalize, scaled_dot_product_attention

from moveset.errors import InputError
from moveset.io.quantization import ROUNDED, SCALE, restored, unrounded
from moveset.text.encoder import TextEmbedding, check_sentences
from moveset.text.packed_linear import PackedLinear, PlainLinear, can_pack

_Linear = PackedLinear | PlainLinear
PACKAGED = Path(__file__).parents[1] / "weights" / "minilm"
_WORDS = "embeddings.word_embeddings.weight"
_LAYERS, _HEADS, _DIM, _EPS = 6, 12, 384, 1e-12


@dataclass(frozen=True, eq=False)
class _Norm:
    weight: Tensor
    bias: Tensor

    def __call__(self, x: Tensor) -> Tensor:
        return layer_norm(x, (_DIM,), self.weight, self.bias, _EPS)


@dataclass(frozen=True, eq=False)
class _Layer:
    """One transformer block; query, key and value are one matrix, so that they cost one product."""

    qkv: _Linear
    out: _Linear
    attention_norm: _Norm
    up: _Linear
    down: _Linear
    output_norm: _Norm


class MiniLM:
    """The default text encoder: 22.7 M parameters, 384 numbers a token, English.

    Args:
        folder: holds ``model.safetensors`` (words rounded, see ``io.quantization``) and ``tokenizer.json``; the
            packaged ones if None.
        device: where it runs and where its results lie.
        max_tokens: longer sentences are cut to this many tokens, [CLS] and [SEP] included; 3 to 512.

    Raises:
        InputError: no such folder, damaged files, or ``max_tokens`` out of range.

    >>> MiniLM().encode(["a person waves"]).tokens.shape
    torch.Size([1, 5, 384])
    """

    name = "minilm"
    dim = _DIM

    def __init__(self, folder: Path | None = None, *, device: torch.device | str = "cpu", max_tokens: int = 64) -> None:
        if not 3 <= max_tokens <= 512:
            raise InputError(f"max_tokens {max_tokens} is not in 3 to 512, the positions the encoder knows; use 64")
        self._folder = None if folder is None else Path(folder).absolute()
        folder = PACKAGED if self._folder is None else self._folder
        self.max_tokens = max_tokens
        self.device = torch.device(device)
        self._tokenizer = _load_tokenizer(folder / "tokenizer.json")
        self._load_weights(folder / "model.safetensors")

    def __reduce__(self) -> tuple[Any, ...]:
        # Packed weights cannot be pickled; whoever gets the pickle reads the folder again.
        return partial(type(self), self._folder, device=self.device, max_tokens=self.max_tokens), ()

    def _load_weights(self, path: Path) -> None:
        try:
            with safe_open(path, framework="pt", device=str(self.device)) as file:
                stored = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
            # Half of the file; the few rows that a sentence needs are restored when it comes.
            self._words, self._word_scale = stored.pop(_WORDS + ROUNDED), stored.pop(_WORDS + SCALE)
            tensors = restored(stored)
            # Every token has type 0, so its vector belongs to the position.
            types = tensors["embeddings.token_type_embeddings.weight"]
            self._positions = tensors["embeddings.position_embeddings.weight"] + types[0]
            self._norm = _Norm(*_pair(tensors, "embeddings.LayerNorm"))
            kind = PackedLinear if can_pack(self.device) else PlainLinear
            self._layers = [_build_layer(tensors, f"encoder.layer.{n}", kind) for n in range(_LAYERS)]
        except (OSError, SafetensorError, KeyError, ValueError) as error:
            raise InputError(f"the text encoder's weights {path} cannot be read ({error}); reinstall moveset") from None

    def token_count(self, sentence: str) -> int:
        """Tokens of the sentence before any cut, [CLS] and [SEP] included."""
        return len(self._tokenizer.encode(*check_sentences([sentence])).ids)

    def encode(self, sentences: Sequence[str]) -> TextEmbedding:
        """Token states of the last layer, and their mean as a unit vector. See ``TextEncoder``."""
        ids = [_cut(e.ids, self.max_tokens) for e in self._tokenizer.encode_batch_fast(check_sentences(sentences))]
        lengths = [len(row) for row in ids]
        longest = max(lengths)
        with torch.inference_mode():
            ids_BL = torch.tensor([row + [0] * (longest - len(row)) for row in ids], device=self.device)
            count_B1 = torch.tensor(lengths, device=self.device)[:, None]
            mask_BL = torch.arange(longest, device=self.device) < count_B1
            ragged = min(lengths) < longest
            x_BLC = self._forward(ids_BL, mask_BL if ragged else None)
            if ragged:
                x_BLC = x_BLC * mask_BL[:, :, None]
            pooled_BC = normalize(x_BLC.sum(1) / count_B1, dim=-1)
        # Inference tensors could not take part in a training graph; copies made outside can.
        return TextEmbedding(x_BLC.clone(), mask_BL.clone(), pooled_BC.clone())

    def _forward(self, ids_BL: Tensor, mask_BL: Tensor | None) -> Tensor:
        batch, length = ids_BL.shape
        keys = None if mask_BL is None else mask_BL[:, None, None, :]
        words = unrounded(self._words[ids_BL], self._word_scale[ids_BL])
        x = self._norm(words + self._positions[:length])
        for layer in self._layers:
            qkv = layer.qkv(x).view(batch, length, 3, _HEADS, _DIM // _HEADS).permute(2, 0, 3, 1, 4)
            y = scaled_dot_product_attention(*qkv.unbind(0), attn_mask=keys)
            x = layer.attention_norm(layer.out.plus(y.transpose(1, 2).reshape(batch, length, _DIM), x))
            x = layer.output_norm(layer.down.plus(layer.up(x), x))
        return x


def _load_tokenizer(path: Path) -> Tokenizer:
    try:
        tokenizer = Tokenizer.from_file(str(path))
    except Exception as error:  # the library raises bare Exception
        raise InputError(f"the tokenizer {path} cannot be read ({error}); reinstall moveset") from None
    # As packaged it pads every sentence to 128 tokens and cuts there; both are done here instead.
    tokenizer.no_padding()
    tokenizer.no_truncation()
    return tokenizer


def _pair(tensors: dict[str, Tensor], name: str) -> tuple[Tensor, Tensor]:
    return tensors[f"{name}.weight"], tensors[f"{name}.bias"]


def _build_layer(tensors: dict[str, Tensor], prefix: str, kind: type[_Linear]) -> _Layer:
    parts = [_pair(tensors, f"{prefix}.attention.self.{name}") for name in ("query", "key", "value")]
    return _Layer(
        qkv=kind(torch.cat([weight for weight, _ in parts]), torch.cat([bias for _, bias in parts])),
        out=kind(*_pair(tensors, f"{prefix}.attention.output.dense")),
        attention_norm=_Norm(*_pair(tensors, f"{prefix}.attention.output.LayerNorm")),
        up=kind(*_pair(tensors, f"{prefix}.intermediate.dense"), "gelu"),
        down=kind(*_pair(tensors, f"{prefix}.output.dense")),
        output_norm=_Norm(*_pair(tensors, f"{prefix}.output.LayerNorm")),
    )


def _cut(ids: list[int], limit: int) -> list[int]:
    """The first tokens and the closing [SEP]."""
    return ids if len(ids) <= limit else [*ids[: limit - 1], ids[-1]]
