"""What is judged, whatever made it: motions of a model, an autoencoder's reconstructions, real or given motion.

All give joint positions in metres at the evaluator's frame rate.

Shapes: F frames, J joints, D features, B clips.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from typing import Any, Protocol

import torch
from torch import Tensor

from moveset.data.resample import splined
from moveset.errors import InputError
from moveset.evaluation.samples import Sample, TestSet
from moveset.motion.clip import Motion
from moveset.motion.features import get_codec
from moveset.pipelines.device import pick_device
from moveset.pipelines.generator import Generator
from moveset.pipelines.model_config import ClipConfig
from moveset.pipelines.model_folder import ModelFolder
from moveset.pipelines.request import Request

Tick = Callable[[int], None]


@dataclass(frozen=True, eq=False)
class Wanted:
    """A motion to make.

    Args:
        parts: (prompt, frames at the evaluator's rate) in order of time; usually one.
        draw: the item it is made for, if any.
    """

    parts: tuple[tuple[str, int], ...]
    seed: int
    draw: Sample | None = None

    @property
    def frames(self) -> int:
        return sum(frames for _, frames in self.parts)

    def request(self, fps: float, rate: float) -> Request:
        """The same asked of a model that makes ``rate`` frames a second."""
        ends = [frames_at(end, fps, rate) for end in accumulate(frames for _, frames in self.parts)]
        frames = tuple(end - begin for begin, end in pairwise([0, *ends]))
        return Request(tuple(prompt for prompt, _ in self.parts), frames, self.seed)


class Source(Protocol):
    """Where judged motion comes from.

    ``slug`` names it in files, ``model``, ``network`` and ``steps`` in tables (None where there is no such thing);
    ``random`` says whether another seed gives another motion; ``segment`` is the seconds between seams of a stream,
    0 where there are none.
    """

    slug: str
    model: str
    network: str | None
    steps: int | None
    random: bool
    segment: float

    def describe(self) -> dict[str, Any]:
        """Everything that its motions depend on besides weights, for JSON."""

    def weights(self) -> dict[str, str]:
        """sha256 of every file of weights that takes part."""

    def generate(self, wanted: Sequence[Wanted], fps: float, tick: Tick = lambda count: None) -> list[Tensor]:
        """Joints (F, J, 3) of each, as long as wanted, or shorter where the model has a limit.

        Args:
            tick: told after some motions how many more there are.
        """


class Given:
    """Motion that is there already: the items' own ("real"), or a set of motions with prompts of their own.

    Args:
        items: the set, if it is not the one that others are judged on.
    """

    network, steps, random, segment = None, None, False, 0.0

    def __init__(self, slug: str, items: TestSet | None = None) -> None:
        self.slug = self.model = slug
        self.items = items

    def describe(self) -> dict[str, Any]:
        return {} if self.items is None else {"motions": self.items.name, "motions_sha256": self.items.sha256}

    def weights(self) -> dict[str, str]:
        return {}

    def generate(self, wanted: Sequence[Wanted], fps: float, tick: Tick = lambda count: None) -> list[Tensor]:
        made = []
        for one in wanted:
            assert one.draw is not None
            made.append(one.draw.joints())
            tick(1)
        return made


class Generated:
    """Motions of a model, as joints at the evaluator's frame rate."""

    random = True

    def __init__(self, generator: Generator) -> None:
        self._generator = generator
        self.slug, self.model = generator.slug, generator.model
        self.network, self.steps = generator.network, generator.steps
        self.skeleton, self.segment = generator.skeleton, generator.segment / generator.fps

    def describe(self) -> dict[str, Any]:
        return self._generator.describe()

    def weights(self) -> dict[str, str]:
        return self._generator.weights()

    def generate(self, wanted: Sequence[Wanted], fps: float, tick: Tick = lambda count: None) -> list[Tensor]:
        made = self._generator.generate([one.request(fps, self._generator.fps) for one in wanted], tick)
        return [joints_at(motion, fps, one.frames) for motion, one in zip(made, wanted, strict=True)]


class Reconstruction:
    """Items through a folder's autoencoder and back, without foot locking: what no denoiser of it can surpass.

    Raises:
        InputError: (when it generates) a set whose items have no motion in the autoencoder's features.
    """

    network, steps, random, segment = "vae", None, False, 0.0

    def __init__(self, bundle: ModelFolder[ClipConfig], *, device: str = "auto", batch: int = 64) -> None:
        self._bundle, self._device, self._batch = bundle, pick_device(device), batch
        self.model = bundle.config.name
        self.slug = f"{self.model}-vae"

    def describe(self) -> dict[str, Any]:
        return {"batch": self._batch, "device": self._device.type}

    def weights(self) -> dict[str, str]:
        return self._bundle.sha256("vae")

    @torch.inference_mode()
    def generate(self, wanted: Sequence[Wanted], fps: float, tick: Tick = lambda count: None) -> list[Tensor]:
        codec, statistics = get_codec(self._bundle.config.codec), self._bundle.normalizer
        mean, std = statistics["feature_mean"], statistics["feature_std"]
        vae = self._bundle.module("vae", self._device)
        made: list[Tensor] = [torch.empty(0)] * len(wanted)
        order = sorted(range(len(wanted)), key=lambda k: wanted[k].frames)
        for start in range(0, len(order), self._batch):
            rows = order[start : start + self._batch]
            features = [(self._features(wanted[k], codec.name) - mean) / std for k in rows]
            lengths = torch.tensor([len(x) for x in features], device=self._device)
            x_BFD = torch.nn.utils.rnn.pad_sequence(features, batch_first=True).to(self._device)
            again = vae.decode(vae.encode(x_BFD, lengths)[0], lengths, x_BFD.shape[1]).cpu() * std + mean
            for k, x, length in zip(rows, again, lengths.tolist(), strict=True):
                made[k] = joints_at(codec.decode(x[:length]), fps, wanted[k].frames)
            tick(len(rows))
        return made

    def _features(self, wanted: Wanted, codec: str) -> Tensor:
        """(F, D) of the item in the autoencoder's own features, a row for each frame that is wanted.

        Of the set's own features, the last row of what is stored stands for the frame after it too.
        """
        draw = wanted.draw
        assert draw is not None
        limit = self._bundle.config.max_frames
        if draw.item.codec == codec:
            stored = draw.item.features()[draw.start : draw.start + draw.frames]
            return torch.cat((stored, stored[-1:]))[: min(draw.frames, limit)]
        if draw.item.motion is None:
            raise InputError(
                f"model {self.model!r} reads {codec!r} features, and the items have {draw.item.codec!r} ones alone; "
                "evaluate an autoencoder of that codec"
            )
        return get_codec(codec).encode(draw.item.motion())[:limit]


def joints_at(motion: Motion, fps: float, frames: int) -> Tensor:
    """The first ``frames`` (or fewer, if it is shorter) joint positions (F, J, 3) of a motion at a frame rate."""
    return motion.resampled(fps).joints[:frames].clone()


def frames_at(frames: int, fps: float, rate: float) -> int:
    """Frames at ``rate`` that last at least as long as so many at ``fps``.

    >>> frames_at(41, 20.0, 20.0), frames_at(26, 12.5, 20.0)
    (41, 41)
    """
    return math.ceil((frames - 1) / fps * rate - 1e-6) + 1


def resampled(joints: Tensor, fps: float, rate: float) -> Tensor:
    """Positions (F, J, 3) at another frame rate, by splines (``data.resample``); as many as lie within the clip."""
    if fps == rate or len(joints) == 1:
        return joints
    count = math.floor((len(joints) - 1) / fps * rate + 1e-6) + 1
    times, at = torch.arange(len(joints), dtype=torch.float64) / fps, torch.arange(count, dtype=torch.float64) / rate
    return splined(joints, times, at.clamp(max=float(times[-1]))).to(joints)
