"""Model configurations by name: what a checkpoint stores beside its weights, and the only way it comes back to life.

A model is described by a *kind* (a short name) and a flat JSON object. Nothing is evaluated, imported by name or
unpickled: an unknown kind, an unknown key, a wrong type or an absurd size is a ``FormatError``.
"""

import dataclasses
import math
import types
import typing
from collections.abc import Callable, Mapping
from typing import Any

from torch import nn

from moveset.errors import FormatError, InputError


class ModelConfig:
    """What configurations have in common, frozen dataclasses of plain numbers, strings and tuples."""

    __slots__ = ()

    def build(self) -> Any:
        """A freshly initialised module; it keeps this configuration as ``module.config``."""
        return _MODULES[type(self)](self)


_KINDS: dict[str, type] = {}
_MODULES: dict[type, Callable[[Any], nn.Module]] = {}


def register(kind: str, config: type, module: Callable[[Any], nn.Module]) -> None:
    """Make a configuration class and its module known under a name. Each kind and each class is registered once."""
    if kind in _KINDS or config in _KINDS.values():
        raise ValueError(f"model kind {kind!r} or configuration {config.__name__} is already registered")
    if not dataclasses.is_dataclass(config):
        raise ValueError(f"{config.__name__} is not a dataclass")
    _KINDS[kind] = config
    _MODULES[config] = module


def kinds() -> tuple[str, ...]:
    return tuple(sorted(_KINDS))


def describe(config: ModelConfig) -> tuple[str, dict[str, Any]]:
    """The (kind, JSON object) under which ``build_model`` builds the same architecture again."""
    for kind, known in _KINDS.items():
        if type(config) is known:
            return kind, {f.name: _plain(getattr(config, f.name)) for f in dataclasses.fields(_KINDS[kind])}
    raise ValueError(f"{type(config).__name__} is not a registered model configuration")


def parse_config(kind: str, config: Mapping[str, Any]) -> Any:
    """The configuration dataclass of a (kind, JSON object) pair.

    Raises:
        FormatError: unknown kind, unknown or missing key, value of the wrong type or out of range.
    """
    if kind not in _KINDS:
        raise FormatError(f"unknown model kind {kind!r}; this version knows {', '.join(kinds())}")
    if not isinstance(config, Mapping):
        raise FormatError(f"the configuration of a {kind!r} model must be an object of named values, not {config!r}")
    cls = _KINDS[kind]
    fields = {f.name: f for f in dataclasses.fields(cls)}
    if unknown := sorted(str(key) for key in config if key not in fields):
        raise FormatError(f"unknown setting {unknown[0]!r} for a {kind!r} model; it has {', '.join(fields)}")
    no_default = dataclasses.MISSING
    for name, field in fields.items():
        if name not in config and field.default is no_default and field.default_factory is no_default:
            raise FormatError(f"the configuration of this {kind!r} model lacks {name!r}; the file is damaged")
    hints = typing.get_type_hints(cls)
    values = {name: _typed(value, hints[name], f"{kind}.{name}") for name, value in config.items()}
    try:
        return cls(**values)
    except InputError as error:
        raise FormatError(f"the configuration of this {kind!r} model cannot be built: {error}") from error


def build_model(kind: str, config: Mapping[str, Any]) -> nn.Module:
    """Build the module that a checkpoint describes, freshly initialised.

    Args:
        kind: a registered name, such as "token_vae".
        config: the JSON object written by ``describe``.

    Raises:
        FormatError: as ``parse_config``.
    """
    module: nn.Module = parse_config(kind, config).build()
    return module


_SIZES = {
    "dropout": (0.0, 0.9), "layers": (1, 99), "blocks": (1, 64), "text_layers": (0, 64), "max_index": (0, 4096),
    "guidance_waves": (4, 4096),
}  # fmt: skip


def require_range(name: str, value: float, low: float, high: float) -> None:
    """For ``__post_init__`` of configurations: keep sizes sane before anything is allocated.

    Raises:
        InputError: value outside [low, high] (or not a number).
    """
    if not low <= value <= high:
        raise InputError(f"{name} = {value} is {f'outside {low} to {high}' if high < math.inf else f'below {low:g}'}")


def require_sizes(config: ModelConfig, **limits: tuple[float, float]) -> None:
    """The same of every number of a configuration: within ``limits``, those of its name in ``_SIZES``, or 1 to 16384.

    Raises:
        InputError: one that is not.
    """
    for field in dataclasses.fields(config):  # type: ignore[arg-type]
        value = getattr(config, field.name)
        if isinstance(value, int | float) and not isinstance(value, bool):
            require_range(field.name, value, *limits.get(field.name, _SIZES.get(field.name, (1, 16384))))


def _plain(value: Any) -> Any:
    return [_plain(v) for v in value] if isinstance(value, tuple) else value


def _typed(value: Any, hint: Any, where: str) -> Any:
    """Check a JSON value against an annotation: int, float, bool, str, None, unions of them, tuple[T, ...]."""
    origin = typing.get_origin(hint)
    if origin in (types.UnionType, typing.Union):
        for option in typing.get_args(hint):
            try:
                return _typed(value, option, where)
            except FormatError:
                continue
    elif origin is tuple:
        item, *_ = typing.get_args(hint)
        if isinstance(value, list | tuple):
            return tuple(_typed(v, item, where) for v in value)
    elif hint is float:
        if isinstance(value, int | float) and not isinstance(value, bool):
            return float(value)
    elif hint in (int, bool, str, types.NoneType) and type(value) is hint:  # `type is`: a bool is no int here
        return value
    wanted = hint.__name__ if isinstance(hint, type) else str(hint)
    raise FormatError(f"{where} must be of type {wanted}, not {value!r}")
