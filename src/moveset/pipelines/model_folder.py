"""A model folder: everything one generator needs, as safetensors and JSON, each file guarded by its sha256.

``config.json``             what the parts are; its ``task`` says what kind of folder it is
``<network>.safetensors``   weights in half precision, or as differences from another network's (``stored_weights``)
``normalizer.safetensors``  statistics of features (and latents)
``prompts.json``            captions of the training data, and the words of all its captions
``prompts.safetensors``     ``pooled`` (P, C), their pooled text embeddings
``manifest.json``           sha256 and size of every other file

Only what is asked for is read, and what is read is verified. The kinds are ``bundle``, ``stream_bundle`` and
``baseline_bundle``.
"""

import hashlib
import json
import math
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Generic, Self, TypeVar

import torch
from safetensors.torch import save as save_safetensors
from torch import Tensor, nn

from moveset.errors import FormatError, InputError
from moveset.io.manifest import VerifiedFolder, json_bytes, json_object, write_whole
from moveset.models.packed import PACKABLE, can_pack, pack
from moveset.motion.features import FeatureCodec, get_codec
from moveset.pipelines.role import named
from moveset.pipelines.stored_weights import halved, restored, subtracted
from moveset.text.familiarity import KnownPrompts

FORMAT = 1
TEXT_TO_MOTION = "text-to-motion"
STREAM = "stream"
BASELINE = "baseline"
_COMMANDS = {TEXT_TO_MOTION: "moveset generate", STREAM: "moveset stream", BASELINE: "moveset evaluate"}


@dataclass(frozen=True, kw_only=True)
class ModelSpec:
    """One network: what ``models.registry.build_model`` takes, and what its file is to be read with.

    Args:
        kind: name of the architecture.
        config: its sizes.
        base: the network whose weights the file tells the differences from; None if it holds the weights themselves.
        base_sha256: of that network's file.
    """

    kind: str
    config: Mapping[str, Any]
    base: str | None = None
    base_sha256: str | None = None


@dataclass(frozen=True, kw_only=True)
class FolderConfig:
    """What every kind of model folder says of itself.

    Args:
        name: what the model is called.
        codec: feature codec of its motions, a name for ``motion.features.get_codec``.
        fps: frames per second of its motions.
        text_encoder: a name for ``text.encoder.get_text_encoder``.
        guidance: default guidance scale w by name of the network, for those that take one.
        far_prompt: a prompt whose best cosine to the training captions is lower gets a warning.
        provenance: on what, how and when it was trained; for people.
        models: the networks by name; filled in when the folder is saved.
    """

    task: ClassVar[str]
    #: Fields with a default that folders of earlier versions lack.
    newer: ClassVar[frozenset[str]] = frozenset()

    name: str
    codec: str = "native"
    fps: float = 20.0
    text_encoder: str = "minilm"
    guidance: Mapping[str, float] = field(default_factory=dict)
    far_prompt: float = 0.5
    provenance: Mapping[str, str | int | float] = field(default_factory=dict)
    models: Mapping[str, ModelSpec] = field(default_factory=dict)

    def steps(self, solver: str) -> tuple[int, ...]:
        """Step counts for which there is a student of this solver ("pcm" or "lcm"), ascending."""
        found = map(named, self.models)
        return tuple(sorted(of.steps for of in found if of.solver == solver and of.steps is not None))

    def feature_codec(self) -> FeatureCodec:
        """The codec of its motions."""
        return get_codec(self.codec)

    def check(self) -> None:
        """Raises ValueError, TypeError or KeyError for numbers that no such model can have."""
        if not self.name or re.search(r"[/\\:\x00-\x1f]|^\.", self.name):
            raise ValueError(f"the name {self.name!r} cannot be part of a file's name")
        if not 0 < self.fps <= 1000:
            raise ValueError("frame rate out of range")
        for name, spec in self.models.items():
            if spec.base is not None and self.models[spec.base].base is not None:
                raise ValueError(f"the base {spec.base!r} of {name!r} is itself stored as differences")

    def check_sampling(self, eta: float, limits: Mapping[str, tuple[int, int]]) -> None:
        """Raises ValueError for fields that are no whole number within limits, and for eta or guidance out of range."""
        for name, (low, high) in limits.items():
            value = getattr(self, name)
            if type(value) is not int or not low <= value <= high:
                raise ValueError(f"{name} {value!r} is no whole number in {low} to {high}")
        if not 0 <= eta <= 1:
            raise ValueError(f"eta {eta} is not in 0 to 1")
        if not all(name in self.models and 0 <= w < math.inf for name, w in self.guidance.items()):
            raise ValueError("guidance of a network that is not there, or below 0")

    @classmethod
    def parse(cls, data: bytes, where: Path) -> Self:
        """From the bytes of a ``config.json``.

        Raises:
            FormatError: not this format, or a newer version of it.
            InputError: a model of another kind.
        """
        raw = json_object(data, where)
        version = raw.pop("format", None)
        if version != FORMAT:
            raise FormatError(f"{where} has format {version!r}; this version reads format {FORMAT}")
        if (task := raw.pop("task", TEXT_TO_MOTION)) != cls.task:
            raise _wrong_kind(where.parent, task, cls.task)
        known = {f.name for f in fields(cls)}
        if wrong := (set(raw) ^ known) - (cls.newer - set(raw)):
            raise FormatError(f"{where} does not fit this version: {sorted(wrong)[0]!r} is missing or unknown")
        try:
            raw["models"] = {name: ModelSpec(**spec) for name, spec in raw["models"].items()}
            config = cls.of(raw)
            config.check()
            return config
        except (TypeError, ValueError, KeyError, AttributeError) as error:
            raise FormatError(f"{where} does not describe a model: {error}") from error

    @classmethod
    def of(cls, raw: Mapping[str, Any]) -> Self:
        """From the JSON object, whose ``models`` are specifications already."""
        return cls(**raw)


Config = TypeVar("Config", bound=FolderConfig)


class ModelFolder(VerifiedFolder, Generic[Config]):
    """An opened model folder; networks are read when they are first asked for. Subclasses name their configuration.

    Args:
        path: the folder.

    Raises:
        FormatError: no model folder, or a damaged one.
        InputError: a model of another kind.
    """

    config_class: type[Config]
    statistics: tuple[str, ...]

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self.config: Config = self.config_class.parse(self.read("config.json"), path / "config.json")
        self._modules: dict[tuple[str, str], nn.Module] = {}

    @classmethod
    def find(cls, name_or_path: str | Path) -> Self:
        """Open a shipped model by name, or a folder.

        Raises:
            InputError: neither a shipped model nor a folder, or a model of another kind.
        """
        return cls(find_folder(name_or_path))

    def module(self, name: str, device: torch.device | str = "cpu") -> nn.Module:
        """The network of that name in float32, for inference only (``models.packed`` on a processor); kept once read.

        Raises:
            FormatError: the model has no such network, or its file is damaged.
        """
        key = name, str(device)
        if key not in self._modules:
            spec = self.spec(name)
            module = _build(spec)
            try:
                module.load_state_dict(self.weights(name), strict=True)
            except (RuntimeError, ValueError) as error:
                raise FormatError(
                    f"{self.path / name}.safetensors does not fit the architecture in config.json; copy the model again"
                ) from error
            module = module.eval().requires_grad_(False).to(device)
            self._modules[key] = pack(module) if spec.kind in PACKABLE and can_pack(device) else module
        return self._modules[key]

    def spec(self, name: str) -> ModelSpec:
        """What the network of that name is built from. Raises FormatError if the model has none."""
        spec = self.config.models.get(name)
        if spec is None:
            raise FormatError(
                f"model {self.config.name!r} has no network {name!r}; it has {', '.join(self.config.models)}"
            )
        return spec

    def weights(self, name: str) -> dict[str, Tensor]:
        """The tensors of a network in single precision, whole.

        Raises:
            FormatError: the model has no such network, or its file is damaged.
            ValueError: differences that do not fit what they were taken from.
        """
        return restored(self.tensors(f"{name}.safetensors"), self._base(name, self.spec(name)))

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
        """Means and standard deviations, by the names in ``statistics``."""
        tensors = self.tensors("normalizer.safetensors")
        if missing := set(self.statistics) - set(tensors):
            raise FormatError(
                f"{self.path / 'normalizer.safetensors'} lacks {sorted(missing)[0]!r}; copy the model again"
            )
        return tensors

    @cached_property
    def captions(self) -> KnownPrompts:
        """Captions the model was trained on, with their pooled embeddings, and the words of all of them."""
        stored = json_object(self.read("prompts.json"), self.path / "prompts.json")
        captions, words = stored.get("captions"), stored.get("words", [])
        pooled = self.tensors("prompts.safetensors").get("pooled")
        if not isinstance(captions, list) or pooled is None or len(captions) != len(pooled):
            raise FormatError(
                f"prompts.json and prompts.safetensors in {self.path} do not belong together; copy the model"
            )
        if not isinstance(words, list) or not all(isinstance(word, str) for word in words):
            raise FormatError(f"the words in {self.path / 'prompts.json'} are no list of words; copy the model again")
        return KnownPrompts(tuple(captions), pooled, frozenset(words))


def shipped() -> dict[str, Path]:
    """Folders of the models that come with the package, by name."""
    root = Path(__file__).parents[1] / "weights"
    return {p.parent.name: p.parent for p in sorted(root.glob("*/manifest.json"))}


def task_of(path: Path) -> str:
    """What a folder's model is for ("text-to-motion", "stream", "baseline"), whatever else ``config.json`` says."""
    config = json_object(VerifiedFolder(path).read("config.json"), path / "config.json")
    return str(config.get("task", TEXT_TO_MOTION))


def find_folder(name_or_path: str | Path) -> Path:
    """Folder of a shipped model, or the folder given.

    Raises:
        InputError: neither.
    """
    known = shipped()
    if str(name_or_path) in known:
        return known[str(name_or_path)]
    path = Path(name_or_path)
    if path.is_dir():
        return path
    names = ", ".join(known) or "none"
    raise InputError(f"unknown model {str(name_or_path)!r}; shipped models: {names}; or give a model folder")


def save_folder(
    path: Path,
    config: FolderConfig,
    modules: Mapping[str, nn.Module],
    normalizer: Mapping[str, Tensor],
    captions: Sequence[str],
    pooled: Tensor,
    bases: Mapping[str, str] | None = None,
    words: Collection[str] = (),
) -> Path:
    """Write a model folder; it appears whole or not at all, and replaces an older one of that name.

    Args:
        path: the folder to make.
        config: all but ``models``, which are taken from the networks' own ``.config``.
        modules: networks by name; stored in half precision.
        normalizer: means and standard deviations by name; stored in float32.
        captions: P sentences the model was trained on.
        pooled: (P, C) their pooled text embeddings.
        bases: by name of a network, the one whose weights it was started from: it is stored as differences from those,
            in half the room.
        words: of all captions of the training; a prompt with others gets a warning.

    Raises:
        ValueError: weights that half precision cannot hold, captions that do not fit their embeddings, or a base that
            is not stored whole.
        FormatError: a configuration that could not be read again.
    """
    from moveset.models.registry import describe

    if len(captions) != len(pooled):
        raise ValueError(f"{len(captions)} captions do not fit {len(pooled)} embeddings")
    bases = bases or {}
    if wrong := [name for name, base in bases.items() if name not in modules or base not in modules or base in bases]:
        raise ValueError(f"{wrong[0]!r} cannot be stored as differences from {bases[wrong[0]]!r}: that is not whole")
    whole = {name: halved(module.state_dict()) for name, module in modules.items() if name not in bases}
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
    blobs["prompts.safetensors"] = save_safetensors(halved({"pooled": pooled}))
    blobs["config.json"] = json_bytes({"format": FORMAT, "task": config.task, **asdict(replace(config, models=specs))})
    type(config).parse(blobs["config.json"], path / "config.json")
    write_whole(path, blobs)
    return path


def _wrong_kind(folder: Path, task: object, wanted: str) -> InputError:
    if task not in _COMMANDS:
        return FormatError(f"model {folder.name!r} has the task {task!r}; this version knows {', '.join(_COMMANDS)}")
    fitting = [name for name, path in shipped().items() if task_of(path) == wanted]
    return InputError(
        f"model {folder.name!r} is a {task} model, for `{_COMMANDS[str(task)]}`; "
        f"a {wanted} model is needed here: {' or '.join(fitting) or 'none is shipped'}"
    )


def _build(spec: ModelSpec) -> nn.Module:
    from moveset.models.registry import build_model

    return build_model(spec.kind, spec.config)
