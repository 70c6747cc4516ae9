"""An evaluator as a folder: the judge's networks with their statistics, and the words that they read.

``config.json``        format, name, codec, frame rate, longest clip, kind and sizes of the network, words, provenance
``model.safetensors``  weights and statistics (``mean``, ``std``)
``words.safetensors``  ``vectors`` (V, W) and ``vocabulary`` (UTF-8 JSON), where words come from a table
``manifest.json``      sha256 and size of every other file

Shapes: M items, F frames, D features of the codec (not normalised), E width of the common space.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Self, cast

import torch
from safetensors.torch import save as save_safetensors
from torch import Tensor

from moveset.errors import FormatError, InputError
from moveset.io.limits import system_errors
from moveset.io.manifest import VerifiedFolder, json_bytes, json_object, write_whole
from moveset.io.quantization import halved
from moveset.models.evaluator import FRAMES_PER_TOKEN, MatchingEvaluator
from moveset.models.registry import build_model, describe
from moveset.motion.features import get_codec
from moveset.pipelines.model_folder import find_folder, shipped
from moveset.text.encoder import get_text_encoder
from moveset.text.glove import GloveWords
from moveset.text.words import MAX_WORDS, TokenWords, Words

FORMAT = 1
DEFAULT_EVALUATOR = "t2m-small"


@dataclass(frozen=True, kw_only=True)
class EvaluatorCard:
    """What an evaluator's folder says of it.

    Args:
        codec: of the features it judges, "hml" or "kit".
        max_frames: longer clips are cut.
        words: "glove", for which the folder has a table, or the name of a text encoder.
        max_words: of a text encoder's tokens, the first ones, as it was trained; that of the words it is made with.
        provenance: on what and how it was trained; for people.
    """

    name: str
    codec: str = "hml"
    fps: float = 20.0
    max_frames: int = 196
    words: str = "minilm"
    max_words: int = MAX_WORDS
    provenance: Mapping[str, str | int | float] = field(default_factory=dict)


class Evaluator:
    """Motions and captions to one space.

    Args:
        module: the networks; ``mean`` and ``std`` are of the codec's features.
        sha256: of its weights file, None if it was never saved.

    Raises:
        FormatError: parts that do not fit each other.
    """

    def __init__(self, card: EvaluatorCard, module: MatchingEvaluator, words: Words, sha256: str | None = None) -> None:
        features, config = get_codec(card.codec).dim, module.config
        if config.features != features:
            raise FormatError(f"an evaluator of {config.features} features cannot judge {card.codec!r}: {features}")
        if (words.width, words.classes) != (config.word_width, config.speech_classes):
            raise FormatError(
                f"words of {words.width} numbers and {words.classes} classes do not fit an evaluator of "
                f"{config.word_width} and {config.speech_classes}"
            )
        self.card = replace(card, max_words=words.most) if isinstance(words, TokenWords) else card
        self.words, self.sha256 = words, sha256
        self.module = module.eval().requires_grad_(False)

    @classmethod
    def open(cls, name_or_path: str | Path = DEFAULT_EVALUATOR, device: torch.device | str = "cpu") -> Self:
        """A shipped evaluator by name, or a folder.

        Raises:
            InputError: neither.
            FormatError: a damaged folder, or one of something else.
        """
        folder = VerifiedFolder(find_folder(name_or_path, "evaluator", shipped("evaluators")))
        where = folder.path / "config.json"
        raw = json_object(folder.read("config.json"), where)
        if raw.pop("task", None) != "evaluator" or raw.pop("format", None) != FORMAT:
            raise FormatError(
                f"{where} describes no evaluator of format {FORMAT}; give a folder made by Evaluator.save"
            )
        try:
            model = raw.pop("model")
            module = cast(MatchingEvaluator, build_model(model["kind"], model["config"]))
            card = EvaluatorCard(**raw)
            if not isinstance(module, MatchingEvaluator):
                raise ValueError(f"a {model['kind']!r} is no evaluator")
            module.load_state_dict({k: v.float() for k, v in folder.tensors("model.safetensors").items()}, strict=True)
        except (KeyError, TypeError, ValueError, RuntimeError) as error:
            said = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise FormatError(f"{folder.path} does not hold a whole evaluator ({said}); copy it again") from error
        return cls(card, module.to(device), _read_words(card, folder), folder.files["model.safetensors"][0])

    def save(self, path: str | Path, *, half: bool = False) -> Path:
        """Write the folder, whole or not at all; in half precision (statistics excepted) if asked for.

        Raises:
            InputError: a path that cannot be written.
        """
        state = {k: v.detach().cpu().contiguous() for k, v in self.module.state_dict().items()}
        if half:
            state |= {k: v for k, v in halved(state).items() if k not in ("mean", "std")}
        kind, config = describe(self.module.config)
        card: dict[str, Any] = {"format": FORMAT, "task": "evaluator", **asdict(self.card)}
        blobs = {
            "config.json": json_bytes(card | {"model": {"kind": kind, "config": config}}),
            "model.safetensors": save_safetensors(state),
        }
        if isinstance(self.words, GloveWords):
            names = torch.frombuffer(bytearray(json.dumps(self.words.vocabulary).encode()), dtype=torch.uint8)
            blobs["words.safetensors"] = save_safetensors(
                {"vectors": self.words.vectors.contiguous(), "vocabulary": names}
            )
        with system_errors(f"write the folder {path}", "choose another", InputError):
            write_whole(Path(path), blobs)
        return Path(path)

    @torch.inference_mode()
    def embed_motions(self, features: Sequence[Tensor], batch: int = 128) -> Tensor:
        """(M, E) float64 on the CPU of clips (F_i, D), each cut to the longest length and to whole tokens.

        Padding is zero *after* normalising: the last token of a clip sees three frames behind it (motionpcm.md 6.4).

        Raises:
            InputError: no clips, another number of features, fewer than four frames, or numbers that are not finite.
        """
        self._check(features)
        mean, std = self.module.mean, self.module.std
        kept = [min(len(x), self.card.max_frames) // FRAMES_PER_TOKEN * FRAMES_PER_TOKEN for x in features]
        out = torch.empty(len(features), self.module.config.joint, dtype=torch.float64)
        # Clips of like length share a batch, so that little padding is computed.
        order = sorted(range(len(kept)), key=kept.__getitem__)
        for start in range(0, len(order), batch):
            rows = order[start : start + batch]
            lengths = torch.tensor([kept[k] for k in rows])
            padded = torch.zeros(len(rows), int(lengths.max()), len(mean), device=mean.device)
            for place, k in zip(padded, rows, strict=True):
                place[: kept[k]] = (features[k][: kept[k]].to(mean) - mean) / std
            out[rows] = self.module.embed_motion(padded, lengths).cpu().double()
        return out

    @torch.inference_mode()
    def embed_texts(self, captions: Sequence[Any], batch: int = 256) -> Tensor:
        """(M, E) float64 on the CPU of sentences, or of captions with tokens where words come from a table.

        Raises:
            InputError: no captions, or ones that the words cannot read.
        """
        if isinstance(captions, str) or not len(captions):
            raise InputError("an evaluator needs a list of at least one caption; give ['a person walks']")
        # What is said twice is read once.
        different = list(dict.fromkeys(captions))
        parts = []
        for start in range(0, len(different), batch):
            words, classes, lengths = self.words.read(different[start : start + batch])
            device = self.module.mean.device
            classes = None if classes is None else classes.to(device)
            parts.append(self.module.embed_text(words.to(device), classes, lengths).cpu().double())
        row = {caption: k for k, caption in enumerate(different)}
        return torch.cat(parts)[[row[caption] for caption in captions]]

    def _check(self, features: Sequence[Tensor]) -> None:
        if not len(features):
            raise InputError("there are no motions to judge; give at least one")
        wanted = self.module.config.features
        for k, x in enumerate(features):
            if x.ndim != 2 or x.shape[1] != wanted or len(x) < FRAMES_PER_TOKEN:
                raise InputError(
                    f"motion {k} has features of shape {tuple(x.shape)}, but the evaluator {self.card.name!r} judges "
                    f"(frames, {wanted}) of at least {FRAMES_PER_TOKEN} frames"
                )
            if not torch.isfinite(x).all():
                raise InputError(f"motion {k} has features that are not finite; leave it out or generate it again")


def _read_words(card: EvaluatorCard, folder: VerifiedFolder) -> Words:
    if card.words != "glove":
        return TokenWords(get_text_encoder(card.words), card.max_words)
    tensors = folder.tensors("words.safetensors")
    try:
        vocabulary = json.loads(tensors["vocabulary"].numpy().tobytes())
        return GloveWords(vocabulary, tensors["vectors"])
    except (KeyError, ValueError, TypeError) as error:
        raise FormatError(f"{folder.path / 'words.safetensors'} is not a table of words ({error})") from error
