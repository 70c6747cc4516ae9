"""The models that a server offers, by name; what is read of them is read when it is first needed, and once."""

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import torch

from moveset.errors import InputError
from moveset.pipelines.device import pick_device
from moveset.pipelines.model_config import DEFAULT_MODEL, DEFAULT_STREAM, ClipConfig, StreamConfig
from moveset.pipelines.model_folder import ModelFolder, find_folder, shipped
from moveset.pipelines.request import TEACHER_STEPS, Method, check_method
from moveset.pipelines.role import is_student
from moveset.pipelines.stream_batch import StreamBatch
from moveset.pipelines.stream_settings import StreamRequest, StreamSettings, check_stream, offered_steps
from moveset.pipelines.text_to_motion import TextToMotion
from moveset.server.failures import RequestError
from moveset.text.encoder import get_text_encoder

SUGGESTIONS = 24
_LONGEST = 40  # characters of a suggestion
_BATCHES = 32  # of settings that streams are made by: clients choose them
_SHIPPED_LICENSE = "CC-BY-4.0"  # weights/LICENSE.md


class Catalog:
    """Models by name.

    Args:
        models: names of shipped models, or folders; by default everything that is shipped. A folder's model is known
            by its own name. The first one of a kind is its default, unless there is moveset's own.

    Raises:
        InputError: no such model or device, or two models of one name.
        FormatError: a damaged model folder.
    """

    def __init__(self, models: Sequence[str | Path] = (), device: torch.device | str = "auto") -> None:
        self.device = pick_device(str(device))
        self.clips: dict[str, TextToMotion] = {}
        self.streams: dict[str, ModelFolder[StreamConfig]] = {}
        for folder in map(find_folder, models or shipped()):
            bundle = ModelFolder.open(folder)
            name = bundle.config.name
            if name in self.clips or name in self.streams:
                raise InputError(f"two models are called {name!r}; give one of them")
            if isinstance(bundle.config, StreamConfig):
                self.streams[name] = bundle
            else:
                self.clips[name] = TextToMotion(ModelFolder.open(folder, ClipConfig), self.device)
        self.encoder = cache(partial(get_text_encoder, device=self.device))
        self._batches: OrderedDict[tuple[str, StreamSettings], StreamBatch] = OrderedDict()
        self._suggestions: dict[str, list[str]] = {}

    @property
    def default(self) -> dict[str, str | None]:
        """Name of the clip and of the stream model that are used where none is named."""
        return {"clip": _first(self.clips, DEFAULT_MODEL), "stream": _first(self.streams, DEFAULT_STREAM)}

    def describe(self) -> list[dict[str, Any]]:
        return [*map(_clip_row, self.clips.values()), *map(_stream_row, self.streams.values())]

    def clip(self, name: str | None) -> TextToMotion:
        """A model of clips; None is the default.

        Raises:
            RequestError: no such model.
        """
        return self._found(self.clips, "clip", name)

    def stream(self, name: str | None) -> ModelFolder[StreamConfig]:
        """A model of streams; None is the default.

        Raises:
            RequestError: no such model.
        """
        return self._found(self.streams, "stream", name)

    def method(self, t2m: TextToMotion, steps: int | None, guidance: float | None) -> Method:
        """How clips are sampled: by a student, or by the teacher in its usual number of steps.

        Raises:
            InputError: no such number of steps, or guidance out of range.
        """
        row, config = _clip_row(t2m), t2m.bundle.config
        _check_steps(row, steps)
        chosen = row["default_steps"] if steps is None else steps
        return check_method(config, _solvers(config)[chosen], chosen, guidance)

    def request(
        self,
        bundle: ModelFolder[StreamConfig],
        prompt: str | None,
        seed: int,
        steps: int | None,
        guidance: float | None,
    ) -> StreamRequest:
        """A checked request of a stream.

        Raises:
            InputError: anything out of range.
        """
        check = _check_steps if is_student(bundle.config.network) else _check_most_steps
        check(_stream_row(bundle), steps)
        return check_stream(bundle.config, prompt, seed=seed, steps=steps, guidance=guidance)

    def batch(self, bundle: ModelFolder[StreamConfig], settings: StreamSettings) -> StreamBatch:
        """What makes streams of these settings, whatever their guidance; the last few that were asked for are kept."""
        key = (bundle.config.name, replace(settings, guidance=0.0))
        if key not in self._batches:
            encoder = self.encoder(bundle.config.text_encoder)
            self._batches[key] = StreamBatch(bundle, settings, device=self.device, encoder=encoder)
            if len(self._batches) > _BATCHES:
                self._batches.popitem(last=False)
        self._batches.move_to_end(key)
        return self._batches[key]

    def ready(self, t2m: TextToMotion) -> TextToMotion:
        t2m.encoder = self.encoder(t2m.bundle.config.text_encoder)
        return t2m

    def suggestions(self, name: str | None) -> list[str]:
        """Sentences to begin with: the model's examples, or captions that stand for what it knows; None is the default
        model of clips.

        Raises:
            RequestError: no such model.
        """
        known = {**{k: t2m.bundle for k, t2m in self.clips.items()}, **self.streams}
        found = self._found(known, "clip" if self.clips else "stream", name)
        if found.config.name not in self._suggestions:
            captions, chosen = found.captions, list(found.config.examples)
            self._suggestions[found.config.name] = chosen or representative(captions.sentences, captions.pooled)
        return self._suggestions[found.config.name]

    def _found(self, models: dict[str, Any], kind: str, name: str | None) -> Any:
        wanted = self.default[kind] if name is None else name
        if wanted not in models:
            what = f"model {name!r}" if name is not None else f"{kind} model"
            choice = f"choose one of {', '.join(models)}" if models else "start the server with one"
            raise RequestError(404, "unknown_model", f"there is no {what} here; {choice}")
        return models[wanted]


def representative(sentences: Sequence[str], pooled: torch.Tensor, count: int = SUGGESTIONS) -> list[str]:
    """Sentences that stand for all, each time the one that brings the others nearest to one that is chosen.

    What is said often comes first, and each thing once; sentences far from all others, slips among them, do not come,
    nor do two sentences in one, or long ones, while there are others.

    Args:
        sentences: K of them.
        pooled: (K, C) unit vectors.
        count: how many are wanted.

    Source: greedy facility location (Nemhauser, Wolsey and Fisher 1978), by cosines.
    """
    short = [k for k, text in enumerate(sentences) if len(text) <= _LONGEST and ". " not in text]
    short = short or list(range(len(sentences)))
    like_KK = (pooled[short].float() @ pooled[short].float().T).clamp_min(0.0)
    nearest_K = torch.zeros(len(short))
    left, chosen = set(range(len(short))), list[int]()
    while left and len(chosen) < count:
        gained = torch.maximum(like_KK, nearest_K).sum(dim=1)
        best = max(sorted(left), key=gained.tolist().__getitem__)
        left.remove(best)
        chosen.append(best)
        nearest_K = torch.maximum(nearest_K, like_KK[best])
    return [sentences[short[k]] for k in chosen]


def _first(models: dict[str, Any], preferred: str) -> str | None:
    return preferred if preferred in models else next(iter(models), None)


def _check_steps(row: dict[str, Any], steps: int | None) -> None:
    # Below here other solvers and networks would be recommended, which clients cannot choose.
    if steps is not None and steps not in row["steps"]:
        choice = ", ".join(map(str, row["steps"]))
        raise InputError(f"model {row['name']!r} has no {steps} steps; choose {choice}")


def _check_most_steps(row: dict[str, Any], steps: int | None) -> None:
    # One thread makes everybody's segments: more steps than the model's own would hold up all other streams.
    if steps is not None and steps > row["default_steps"]:
        raise InputError(
            f"{steps} steps are more than the limit of {row['default_steps']} of model {row['name']!r}; ask for fewer"
        )


def _solvers(config: ClipConfig) -> dict[int, str]:
    """Who samples in so many steps: the students, then the teacher."""
    return dict.fromkeys(config.steps("pcm"), "pcm") | (
        {TEACHER_STEPS: "teacher"} if "teacher" in config.models else {}
    )


def _clip_row(t2m: TextToMotion) -> dict[str, Any]:
    config = t2m.bundle.config
    solvers = _solvers(config)
    default = next(iter(solvers))
    return {
        "name": config.name,
        "task": "clip",
        "fps": config.fps,
        "steps": list(solvers),
        "default_steps": default,
        "guidance": check_method(config, solvers[default], default).guidance,
        "min_seconds": config.min_frames / config.fps,
        "max_seconds": config.max_frames / config.fps,
        "license": _license(t2m.bundle),
    }


def _stream_row(bundle: ModelFolder[StreamConfig]) -> dict[str, Any]:
    config = bundle.config
    settings = check_stream(config).settings
    return {
        "name": config.name,
        "task": "stream",
        "fps": config.fps,
        "steps": list(offered_steps(config)),
        "default_steps": settings.steps,
        "guidance": settings.guidance,
        "max_seconds": None,
        "segment_frames": config.segment,
        "idle": config.idle,
        "license": _license(bundle),
    }


def _license(bundle: ModelFolder[ClipConfig] | ModelFolder[StreamConfig]) -> str | None:
    if bundle.path in shipped().values():
        return _SHIPPED_LICENSE
    found = bundle.config.provenance.get("license")
    return None if found is None else str(found)
