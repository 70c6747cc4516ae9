"""Text encoders of the Hugging Face hub that the user has on disk: CLIP, T5 and sentence-T5, through ``transformers``.

Nothing is downloaded and no pickled weights are read: a model is a local folder, or a hub id whose files are in the
local cache. CLIP: Radford et al. 2021, arXiv 2103.00020; T5: Raffel et al. 2020, arXiv 1910.10683; sentence-T5: Ni et
al. 2021, arXiv 2108.08877, the encoder of MotionLCM and MotionPCM.

Shapes: ``B`` sentences, ``L`` tokens, ``C`` width.
"""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

import torch
from torch import Tensor
from torch.nn.functional import linear, normalize

from moveset.errors import InputError
from moveset.text.encoder import TextEmbedding, check_sentences

if TYPE_CHECKING:
    from transformers import PreTrainedTokenizerBase

_Loaded = TypeVar("_Loaded")


class _HubText:
    """What the three have in common: a tokenizer, a limit, and running without a training graph."""

    def __init__(self, family: str, where: str, device: torch.device | str, model: Any, max_tokens: int) -> None:
        self.name = f"{family}:{where}"
        self.device = torch.device(device)
        self.max_tokens, self.dim = max_tokens, model.config.hidden_size
        self._model = model.eval().requires_grad_(False).to(self.device)
        self._tokenizer: PreTrainedTokenizerBase = _from_disk(_transformers().AutoTokenizer.from_pretrained, where)

    def token_count(self, sentence: str) -> int:
        """Tokens of the sentence before any cut, special tokens included."""
        return len(self._tokenizer(check_sentences([sentence])[0])["input_ids"])

    def encode(self, sentences: Sequence[str]) -> TextEmbedding:
        """See ``TextEncoder``."""
        batch = self._tokenizer(
            check_sentences(sentences),
            padding="longest",
            padding_side="right",
            truncation=True,
            max_length=self.max_tokens,
            return_tensors="pt",
        ).to(self.device)
        with torch.inference_mode():
            tokens_BLC, mask_BL, pooled_BC = self._run(batch["input_ids"], batch["attention_mask"])
            tokens_BLC = tokens_BLC.float() * mask_BL[:, :, None]
            pooled_BC = normalize(pooled_BC.float(), dim=-1)
        # Inference tensors could not take part in a training graph; copies made outside can.
        return TextEmbedding(tokens_BLC.clone(), mask_BL.clone(), pooled_BC.clone())

    def _run(self, ids_BL: Tensor, attention_BL: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        raise NotImplementedError


class ClipText(_HubText):
    """The text tower of a CLIP model: token states after its last norm; pooled is the projected text feature.

    Args:
        where: local folder, or hub id such as "openai/clip-vit-base-patch32".

    Raises:
        InputError: ``transformers`` is not installed, or the model is not on this machine.
    """

    def __init__(self, where: str, *, device: torch.device | str = "cpu") -> None:
        model = _from_disk(_transformers().CLIPTextModelWithProjection.from_pretrained, where, use_safetensors=True)
        super().__init__("clip", where, device, model, model.config.max_position_embeddings)

    def _run(self, ids_BL: Tensor, attention_BL: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        out = self._model(input_ids=ids_BL, attention_mask=attention_BL)
        return out.last_hidden_state, attention_BL.bool(), out.text_embeds


class T5Text(_HubText):
    """The encoder of a T5 model: its token states; pooled is their mean.

    Args:
        where: local folder, or hub id such as "google-t5/t5-base".

    Raises:
        InputError: ``transformers`` is not installed, or the model is not on this machine.
    """

    _family, _max_tokens = "t5", 128

    def __init__(self, where: str, *, device: torch.device | str = "cpu") -> None:
        model = _from_disk(_transformers().T5EncoderModel.from_pretrained, where, use_safetensors=True)
        super().__init__(self._family, where, device, model, self._max_tokens)

    def _run(self, ids_BL: Tensor, attention_BL: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        states_BLC = self._model(input_ids=ids_BL, attention_mask=attention_BL).last_hidden_state
        weight_BL1 = attention_BL[:, :, None].to(states_BLC.dtype)
        return states_BLC, attention_BL.bool(), (states_BLC * weight_BL1).sum(1) / weight_BL1.sum(1)


class SentenceT5(T5Text):
    """Sentence-T5 as the published models use it: *one* token a sentence, the mean state, projected, of unit length.

    Args:
        where: local folder, or hub id such as "sentence-transformers/sentence-t5-large", in the layout of
            sentence-transformers (the projection is ``2_Dense/model.safetensors``).

    Raises:
        InputError: ``transformers`` is not installed, or the model or its projection is not on this machine.
    """

    _family, _max_tokens = "sentence-t5", 256

    def __init__(self, where: str, *, device: torch.device | str = "cpu") -> None:
        from safetensors.torch import load_file

        super().__init__(where, device=device)
        find = _transformers().utils.hub.cached_file
        path = _from_disk(find, where, filename="model.safetensors", subfolder="2_Dense")
        self._projection = load_file(path, device=str(self.device))["linear.weight"].float()
        self.dim = len(self._projection)

    def _run(self, ids_BL: Tensor, attention_BL: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        pooled_BC = linear(super()._run(ids_BL, attention_BL)[2].float(), self._projection)
        pooled_BC = normalize(pooled_BC, dim=-1)
        return pooled_BC[:, None], torch.ones_like(attention_BL[:, :1], dtype=torch.bool), pooled_BC


def _transformers() -> Any:
    try:
        import transformers
    except ImportError:
        raise InputError("CLIP and T5 text encoders need `transformers`; run `pip install moveset[hub]`") from None
    return transformers


def _from_disk(load: Callable[..., _Loaded], where: str, **options: str | bool) -> _Loaded:
    try:
        return load(where, local_files_only=True, **options)
    except (OSError, ValueError) as error:
        first = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(
            f"the text encoder {where!r} is not complete on this machine ({first}); fetch it once with "
            f"`hf download {where}`, or give a folder with config.json, tokenizer.json and model.safetensors"
        ) from None
