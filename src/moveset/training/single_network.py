"""Trainings of one network: what the engine saves and steps, by one name."""

import math
from dataclasses import dataclass, field, fields
from typing import Any, Literal, get_args, get_origin

import torch
from torch import nn

from moveset.errors import InputError
from moveset.models.registry import describe, require_range
from moveset.training.ema import Ema
from moveset.training.engine import Task
from moveset.training.optim import cosine_lr

_SHARES = {
    "condition_dropout", "sides", "heading_change", "frozen_flow", "standing", "smoothing", "composed_share",
    "inference_points", "mismatched_text", "discriminator_max_noise", "rollout_share",
}  # fmt: skip
_NEEDED = {"batch", "lr", "points", "phases", "levels", "window", "max_words"}


@dataclass(frozen=True, kw_only=True)
class NetworkConfig:
    """What is trained and how; ``kind`` is the architecture of ``model``, for whoever reads a checkpoint."""

    model: Any
    kind: str = field(init=False, default="")

    def __post_init__(self) -> None:
        if self.model is not None:  # a student's is known when its teacher is
            object.__setattr__(self, "kind", describe(self.model)[0])
        require_sense(self)


def require_sense(config: Any) -> None:
    """For ``__post_init__`` of trainings' settings: names are known ones, shares within 0 to 1, no number below 0.

    Raises:
        InputError: one that is not.
    """
    for each in fields(config):
        value, known = getattr(config, each.name), get_args(each.type)
        if get_origin(each.type) is Literal and value not in known:
            raise InputError(f"{each.name} {value!r} is not one of {', '.join(known)}")
        if isinstance(value, int | float):
            require_range(each.name, value, 0.0, 1.0 if each.name in _SHARES else math.inf)
            if each.name in _NEEDED and not value:
                raise InputError(f"{each.name}=0 trains nothing; give more than 0")


class SingleNetworkTask(Task):
    """One network, one optimiser, a copy that follows if there is one, and a cosine from ``config.lr`` down.

    Subclasses set ``network``, the name of the attribute that holds the network, and of its files.
    """

    network: str
    config: Any
    optimizer: torch.optim.Optimizer
    ema: Ema | None = None

    def modules(self) -> dict[str, nn.Module]:
        return {self.network: getattr(self, self.network)}

    def averages(self) -> dict[str, nn.Module]:
        return {} if self.ema is None else {f"{self.network}_ema": self.ema.module}

    def optimizers(self) -> dict[str, torch.optim.Optimizer]:
        return {self.network: self.optimizer}

    def learning_rates(self, step: int, steps: int) -> dict[str, float]:
        return {self.network: cosine_lr(step, self.config.lr, self.config.warmup, steps)}
