"""A model folder: everything one generator needs, as safetensors and JSON, each file guarded by its sha256.

``config.json``             what the parts are; its ``task`` says what kind of folder it is
``<network>.safetensors``   weights in half precision, in 8 bits, or as differences from another network's
``normalizer.safetensors``  statistics of features (and latents)
``prompts.json``            captions of the training data, and the words of all its captions
``prompts.safetensors``     ``pooled`` (P, C), their pooled text embeddings, in 8 bits
``manifest.json``           sha256 and size of every other file

Only what is asked for is read, and what is read is verified. ``model_config`` has the kinds.
"""

import hashlib
import json
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Generic, Self, TypeVar, cast

import torch
from safetensors.torch import save as save_safetensors
from torch import Tensor, nn

from moveset.errors import FormatError, InputError
from moveset.io.manifest import VerifiedFolder, json_bytes, json_object, write_whole
from moveset.io.quantization import compacted, halved, restored, subtracted
from moveset.models.packed import PACKABLE, pack
from moveset.models.registry import build_model, describe
from moveset.models.symmetric import Symmetric
from moveset.motion.native import NativeCodec
from moveset.pipelines.model_config import (
    BASELINE,
    CONFIGS,
    FORMAT,
    STREAM,
    TEXT_TO_MOTION,
    FolderConfig,
    ModelSpec,
)
from moveset.text.familiarity import KnownPrompts
from moveset.text.packed_linear import can_pack

_COMMANDS = {TEXT_TO_MOTION: "moveset generate", STREAM: "moveset stream", BASELINE: "moveset evaluate"}
_LEAN = 1e-3  # of a standard deviation

Config = TypeVar("Config", bound=FolderConfig)


class ModelFolder(VerifiedFolder, Generic[Config]):
    """An opened model folder; networks are read when they are first asked for.

    Args:
        kind: what it has to be, by the type of its configuration; None for any.

    Raises:
        FormatError: no model folder, or a damaged one.
        InputError: a model of another kind.
    """

    def __init__(self, path: Path, kind: type[Config] | None = None) -> None:
        super().__init__(path)
        data, where = self.read("config.json"), path / "config.json"
        task = json_object(data, where).get("task", TEXT_TO_MOTION)
        if task not in CONFIGS:
            raise FormatError(f"model {path.name!r} has the task {task!r}; this version knows {', '.join(CONFIGS)}")
        if kind is not None and kind.task != task:
            raise _wrong_kind(path, task, kind.task)
        self.config = cast(Config, CONFIGS[task].parse(data, where))
        self._modules: dict[tuple[str, str], nn.Module] = {}

    @classmethod
    def open(cls, name_or_path: str | Path, kind: type[Config] | None = None) -> Self:
        """A shipped model by name, or a folder.

        Raises:
            InputError: neither a shipped model nor a folder, or a model of another kind.
            FormatError: a damaged folder.
        """
        return cls(find_folder(name_or_path), kind)

    def module(self, name: str, device: torch.device | str = "cpu") -> nn.Module:
        """The network of that name in float32, for inference only (``models.packed`` on a processor); kept once read.

        Symmetric ones come with their mirror image.

        Raises:
            FormatError: the model has no such network, its file is damaged, or statistics lean to one side.
        """
        key = name, str(device)
        if key not in self._modules:
            spec = self.config.models.get(name)
            if spec is None:
                known = ", ".join(self.config.models)
                raise FormatError(f"model {self.config.name!r} has no network {name!r}; it has {known}")
            module = build_model(spec.kind, spec.config)
            try:
                whole = restored(self.tensors(f"{name}.safetensors"), self._base(name, spec))
                module.load_state_dict(whole, strict=True)
            except (RuntimeError, ValueError) as error:
                raise FormatError(
                    f"{self.path / name}.safetensors does not fit the architecture in config.json; copy the model again"
                ) from error
            module = module.eval().requires_grad_(False).to(device)
            module = pack(module) if spec.kind in PACKABLE and can_pack(device) else module
            self._modules[key] = self._even(module).to(device) if name in self.config.symmetric else module
        return self._modules[key]

    def sha256(self, *names: str) -> dict[str, str]:
        """sha256 of the files of these networks, of those they are stored as differences from, and of the statistics.

        And of what config.json says of each network, smoothing among it.
        """
        specs = {name: self.config.models[name] for name in names if name in self.config.models}
        said = {name: json.dumps(asdict(spec), sort_keys=True).encode() for name, spec in specs.items()}
        bases = [spec.base for spec in specs.values()]
        files = [f"{name}.safetensors" for name in dict.fromkeys([*names, *filter(None, bases), "normalizer"])]
        found = {file: self.files[file][0] for file in files if file in self.files}
        return found | {f"{name} in config.json": hashlib.sha256(text).hexdigest() for name, text in said.items()}

    def _even(self, network: nn.Module) -> Symmetric:
        codec = self.config.feature_codec()
        if not isinstance(codec, NativeCodec):
            raise FormatError(f"{self.path}: features of {codec.name!r} are not symmetric; export it without")
        order, signs = codec.mirror()
        mean, std = (self.normalizer[statistic] for statistic in self.config.statistics)
        lean = ((mean[order] * signs - mean) / std, std[order] / std - 1)
        if max(float(part.abs().max()) for part in lean) > _LEAN:
            raise FormatError(f"{self.path}: its statistics lean to one side, so nothing is symmetric; pack it without")
        return Symmetric(network, order, signs).eval()

    def _base(self, name: str, spec: ModelSpec) -> dict[str, Tensor] | None:
        """The tensors of the network that this one is stored as differences from."""
        if spec.base is None:
            return None
        file = f"{spec.base}.safetensors"
        if file in self.files and self.files[file][0] != spec.base_sha256:
            raise FormatError(
                f"{self.path / name}.safetensors holds differences from another {file}; copy the whole model folder"
            )
        return self.tensors(file)

    @cached_property
    def normalizer(self) -> dict[str, Tensor]:
        """Means and standard deviations, by the names in the configuration's ``statistics``."""
        tensors = self.tensors("normalizer.safetensors")
        if missing := set(self.config.statistics) - set(tensors):
            raise FormatError(
                f"{self.path / 'normalizer.safetensors'} lacks {sorted(missing)[0]!r}; copy the model again"
            )
        return tensors

    @cached_property
    def captions(self) -> KnownPrompts:
        """Captions the model was trained on, with their pooled embeddings, and the words of all of them."""
        stored = json_object(self.read("prompts.json"), self.path / "prompts.json")
        captions, words = stored.get("captions"), stored.get("words", [])
        apart = f"prompts.json and prompts.safetensors in {self.path} do not belong together; copy the model"
        try:
            pooled = restored(self.tensors("prompts.safetensors"))["pooled"]
        except (KeyError, ValueError) as error:
            raise FormatError(apart) from error
        if not isinstance(captions, list) or len(captions) != len(pooled):
            raise FormatError(apart)
        if not isinstance(words, list) or not all(isinstance(word, str) for word in words):
            raise FormatError(f"the words in {self.path / 'prompts.json'} are no list of words; copy the model again")
        return KnownPrompts(tuple(captions), pooled, frozenset(words))


def shipped(below: str = "") -> dict[str, Path]:
    """Folders of the models that come with the package, or of the "evaluators", by name."""
    root = Path(__file__).parents[1] / "weights" / below
    return {p.parent.name: p.parent for p in sorted(root.glob("*/manifest.json"))}


def find_folder(name_or_path: str | Path, what: str = "model", known: Mapping[str, Path] | None = None) -> Path:
    """Folder of a shipped model, or of another of what is ``known``, or the folder given.

    Raises:
        InputError: neither.
    """
    known = shipped() if known is None else known
    if str(name_or_path) in known:
        return known[str(name_or_path)]
    path = Path(name_or_path)
    if path.is_dir():
        return path
    names = ", ".join(known) or "none"
    raise InputError(f"unknown {what} {str(name_or_path)!r}; shipped {what}s: {names}; or give the folder of one")


def save_model(
    path: Path,
    config: FolderConfig,
    modules: Mapping[str, nn.Module],
    normalizer: Mapping[str, Tensor],
    captions: Sequence[str],
    pooled: Tensor,
    bases: Mapping[str, str] | None = None,
    words: Collection[str] = (),
    compact: Collection[str] = (),
) -> Path:
    """Write a model folder; it appears whole or not at all, and replaces an older one of that name.

    Args:
        config: all but ``models``, which are taken from the networks' own ``.config``.
        modules: networks by name; stored in half precision.
        normalizer: what ``config.needed`` names, means and standard deviations; stored in float32.
        captions: P sentences the model was trained on.
        pooled: (P, C) their pooled text embeddings.
        bases: by name of a network, the one whose weights it was started from: it is stored as differences from those,
            in half the room.
        words: of all captions of the training; a prompt with others gets a warning.
        compact: networks whose matrices are stored in 8 bits, in half the room.

    Raises:
        ValueError: missing statistics, weights that half precision cannot hold, captions that do not fit their
            embeddings, or a base that is not stored whole.
        FormatError: a configuration that could not be read again.
    """
    if missing := set(config.needed) - set(normalizer):
        raise ValueError(f"the normalizer lacks {sorted(missing)[0]!r}")
    if len(captions) != len(pooled):
        raise ValueError(f"{len(captions)} captions do not fit {len(pooled)} embeddings")
    bases = bases or {}
    if wrong := [name for name, base in bases.items() if name not in modules or base not in modules or base in bases]:
        raise ValueError(f"{wrong[0]!r} cannot be stored as differences from {bases[wrong[0]]!r}: that is not whole")
    whole = {
        name: (compacted if name in compact else halved)(module.state_dict())
        for name, module in modules.items()
        if name not in bases
    }
    blobs = {f"{name}.safetensors": save_safetensors(tensors) for name, tensors in whole.items()}
    specs = {}
    for name, module in modules.items():
        kind, settings = describe(module.config)  # type: ignore[arg-type]
        specs[name] = ModelSpec(kind=kind, config=settings)
        if name in bases:
            base = bases[name]
            sha256 = hashlib.sha256(blobs[f"{base}.safetensors"]).hexdigest()
            specs[name] = replace(specs[name], base=base, base_sha256=sha256)
            blobs[f"{name}.safetensors"] = save_safetensors(subtracted(module.state_dict(), whole[base]))
    blobs["normalizer.safetensors"] = save_safetensors({k: v.float().contiguous() for k, v in normalizer.items()})
    blobs["prompts.json"] = json_bytes({"captions": list(captions), "words": sorted(words)})
    blobs["prompts.safetensors"] = save_safetensors(compacted({"pooled": pooled}))
    blobs["config.json"] = json_bytes({"format": FORMAT, "task": config.task, **asdict(replace(config, models=specs))})
    type(config).parse(blobs["config.json"], path / "config.json")
    write_whole(path, blobs)
    return path


def _wrong_kind(folder: Path, task: str, wanted: str) -> InputError:
    fitting = [name for name, path in shipped().items() if ModelFolder[Any](path).config.task == wanted]
    return InputError(
        f"model {folder.name!r} is a {task} model, for `{_COMMANDS[task]}`; "
        f"a {wanted} model is needed here: {' or '.join(fitting) or 'none is shipped'}"
    )
