"""A model folder: everything one generator needs, as safetensors and JSON, each file guarded by its sha256.

``config.json``             what the parts are; its ``task`` says what kind of folder it is
``<network>.safetensors``   weights in half precision
``normalizer.safetensors``  statistics of features (and latents)
``prompts.json``            captions of the training data
``prompts.safetensors``     ``pooled`` (P, C), their pooled text embeddings
``manifest.json``           sha256 and size of every other file

Only what is asked for is read, and what is read is verified. ``bundle`` and ``stream_bundle`` are the two kinds.
"""

import hashlib
import json
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any, ClassVar, Generic, Self, TypeVar

import torch
from safetensors import SafetensorError
from safetensors.torch import load as load_safetensors
from safetensors.torch import save as save_safetensors
from torch import Tensor, nn

from moveset.errors import FormatError, InputError
from moveset.io.limits import atomic_write, read_limited
from moveset.models.packed import PACKABLE, can_pack, pack
from moveset.text.familiarity import KnownPrompts

FORMAT = 1
MAX_FILE = 512 * 2**20
TEXT_TO_MOTION = "text-to-motion"
STREAM = "stream"
_COMMANDS = {TEXT_TO_MOTION: "moveset generate", STREAM: "moveset stream"}


@dataclass(frozen=True, kw_only=True)
class ModelSpec:
    """Architecture of one network: what ``models.registry.build_model`` takes."""

    kind: str
    config: Mapping[str, Any]


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

    name: str
    codec: str = "native"
    fps: float = 20.0
    text_encoder: str = "minilm"
    guidance: Mapping[str, float] = field(default_factory=dict)
    far_prompt: float = 0.5
    provenance: Mapping[str, str | int | float] = field(default_factory=dict)
    models: Mapping[str, ModelSpec] = field(default_factory=dict)

    def steps(self, solver: str) -> tuple[int, ...]:
        """Step counts for which there is a student: the numbers behind "pcm-" or "lcm-", ascending."""
        prefix = f"{solver}-"
        return tuple(sorted(int(name[len(prefix) :]) for name in self.models if name.startswith(prefix)))

    def check(self) -> None:
        """Raises ValueError, TypeError or KeyError for numbers that no such model can have."""
        if not 0 < self.fps <= 1000:
            raise ValueError("frame rate out of range")

    @classmethod
    def parse(cls, data: bytes, where: Path) -> Self:
        """From the bytes of a ``config.json``.

        Raises:
            FormatError: not this format, or a newer version of it.
            InputError: a model of another kind.
        """
        raw = _json_object(data, where)
        version = raw.pop("format", None)
        if version != FORMAT:
            raise FormatError(f"{where} has format {version!r}; this version reads format {FORMAT}")
        if (task := raw.pop("task", TEXT_TO_MOTION)) != cls.task:
            raise _wrong_kind(where.parent, task, cls.task)
        known = {f.name for f in fields(cls)}
        if wrong := set(raw) ^ known:
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


class VerifiedFolder:
    """Files beside a manifest; a byte that is read is a byte that was checked.

    Args:
        path: the folder.

    Raises:
        FormatError: no model folder.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        if not (path / "manifest.json").is_file():
            raise FormatError(f"{path} is no model folder: it has no manifest.json; give a folder made by save_bundle")

    @cached_property
    def files(self) -> dict[str, tuple[str, int]]:
        """sha256 and size in bytes of every file, by name, as the manifest has them."""
        where = self.path / "manifest.json"
        raw = _json_object(read_limited(where, 2**20), where)
        try:
            if any(Path(name).name != name for name in raw["files"]):
                raise ValueError("a file outside the folder")
            return {name: (str(entry["sha256"]), int(entry["bytes"])) for name, entry in raw["files"].items()}
        except (TypeError, ValueError, KeyError, AttributeError) as error:
            raise FormatError(f"{where} is not a manifest; copy the model folder again") from error

    @property
    def task(self) -> str:
        """What the folder's model is for, "text-to-motion" or "stream", whatever else its ``config.json`` says."""
        return str(_json_object(self.read("config.json"), self.path / "config.json").get("task", TEXT_TO_MOTION))

    def read(self, file: str) -> bytes:
        """The bytes of one file.

        Raises:
            FormatError: not in the manifest, or damaged.
            InputError: missing.
        """
        if file not in self.files:
            raise FormatError(f"{self.path} has no {file} in its manifest; copy the model folder again")
        path = self.path / file
        data = read_limited(path, MAX_FILE)
        sha256, size = self.files[file]
        if len(data) != size or hashlib.sha256(data).hexdigest() != sha256:
            raise FormatError(
                f"{path} is damaged: it does not match the sha256 in manifest.json; reinstall moveset or copy it again"
            )
        return data

    def tensors(self, file: str) -> dict[str, Tensor]:
        """The tensors of one safetensors file, verified."""
        data = self.read(file)
        try:
            return load_safetensors(data)
        except SafetensorError as error:
            raise FormatError(f"{self.path / file} is not a safetensors file: {error}") from error

    def verify(self) -> int:
        """Check every file against the manifest; the number of bytes checked.

        Raises:
            FormatError: naming the first file that is damaged or missing.
        """
        return sum(len(self.read(name)) for name in self.files)


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
        self._modules: dict[str, nn.Module] = {}

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
        if name not in self._modules:
            spec = self.config.models.get(name)
            if spec is None:
                raise FormatError(
                    f"model {self.config.name!r} has no network {name!r}; it has {', '.join(self.config.models)}"
                )
            module = _build(spec)
            state = {key: _single(value) for key, value in self.tensors(f"{name}.safetensors").items()}
            try:
                module.load_state_dict(state, strict=True)
            except RuntimeError as error:
                raise FormatError(
                    f"{self.path / name}.safetensors does not fit the architecture in config.json; copy the model again"
                ) from error
            module = module.eval().requires_grad_(False).to(device)
            self._modules[name] = pack(module) if spec.kind in PACKABLE and can_pack(device) else module
        return self._modules[name]

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
        """Captions the model was trained on, with their pooled embeddings."""
        captions = _json_object(self.read("prompts.json"), self.path / "prompts.json").get("captions")
        pooled = self.tensors("prompts.safetensors").get("pooled")
        if not isinstance(captions, list) or pooled is None or len(captions) != len(pooled):
            raise FormatError(
                f"prompts.json and prompts.safetensors in {self.path} do not belong together; copy the model"
            )
        return KnownPrompts(tuple(captions), pooled)


def shipped() -> dict[str, Path]:
    """Folders of the models that come with the package, by name."""
    root = Path(__file__).parents[1] / "weights"
    return {p.parent.name: p.parent for p in sorted(root.glob("*/manifest.json"))}


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
) -> Path:
    """Write a model folder; it appears whole or not at all, and replaces an older one of that name.

    Args:
        path: the folder to make.
        config: all but ``models``, which are taken from the networks' own ``.config``.
        modules: networks by name; stored in half precision.
        normalizer: means and standard deviations by name; stored in float32.
        captions: P sentences the model was trained on.
        pooled: (P, C) their pooled text embeddings.

    Raises:
        ValueError: weights that half precision cannot hold, or captions that do not fit their embeddings.
        FormatError: a configuration that could not be read again.
    """
    from moveset.models.registry import describe

    if len(captions) != len(pooled):
        raise ValueError(f"{len(captions)} captions do not fit {len(pooled)} embeddings")
    specs = {}
    blobs: dict[str, bytes] = {}
    for name, module in modules.items():
        kind, settings = describe(module.config)  # type: ignore[arg-type]
        specs[name] = ModelSpec(kind=kind, config=settings)
        blobs[f"{name}.safetensors"] = save_safetensors({k: _half(k, v) for k, v in module.state_dict().items()})
    blobs["normalizer.safetensors"] = save_safetensors({k: v.float().contiguous() for k, v in normalizer.items()})
    blobs["prompts.json"] = _dump({"captions": list(captions)})
    blobs["prompts.safetensors"] = save_safetensors({"pooled": _half("pooled", pooled)})
    blobs["config.json"] = _dump({"format": FORMAT, "task": config.task, **asdict(replace(config, models=specs))})
    type(config).parse(blobs["config.json"], path / "config.json")
    _write_whole(path, blobs)
    return path


def _write_whole(path: Path, blobs: Mapping[str, bytes]) -> None:
    """The files and their manifest as a folder that replaces the one at ``path`` by renaming."""
    files = {k: {"sha256": hashlib.sha256(v).hexdigest(), "bytes": len(v)} for k, v in sorted(blobs.items())}
    path.parent.mkdir(parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp(prefix=f".{path.name}.", dir=path.parent))
    try:
        for name, blob in {**blobs, "manifest.json": _dump({"files": files})}.items():
            with atomic_write(folder / name) as file:
                file.write(blob)
        folder.chmod(0o755)
        if path.exists():
            path.rename(folder / ".old")
        folder.rename(path)
        shutil.rmtree(path / ".old", ignore_errors=True)
    except BaseException:
        shutil.rmtree(folder, ignore_errors=True)
        raise


def _wrong_kind(folder: Path, task: object, wanted: str) -> InputError:
    if task not in _COMMANDS:
        return FormatError(f"model {folder.name!r} has the task {task!r}; this version knows {', '.join(_COMMANDS)}")
    fitting = [name for name, path in shipped().items() if VerifiedFolder(path).task == wanted]
    return InputError(
        f"model {folder.name!r} is a {task} model, for `{_COMMANDS[str(task)]}`; "
        f"a {wanted} model is needed here: {' or '.join(fitting) or 'none is shipped'}"
    )


def _build(spec: ModelSpec) -> nn.Module:
    from moveset.models.registry import build_model

    return build_model(spec.kind, spec.config)


def _half(name: str, value: Tensor) -> Tensor:
    if not value.is_floating_point():
        return value.contiguous()
    half = value.detach().cpu().half().contiguous()
    if not torch.isfinite(half).all():
        raise ValueError(f"{name} has values that half precision cannot hold")
    return half


def _single(value: Tensor) -> Tensor:
    return value.float() if value.is_floating_point() else value


def _dump(data: Mapping[str, object]) -> bytes:
    return (json.dumps(data, indent=1, ensure_ascii=False) + "\n").encode()


def _json_object(data: bytes, where: Path) -> dict[str, Any]:
    try:
        raw = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise FormatError(f"{where} is not JSON: {error}; copy the model folder again") from error
    if not isinstance(raw, dict):
        raise FormatError(f"{where} is not a JSON object; copy the model folder again")
    return raw
