"""Trainings of one network: what the engine saves and steps, by one name."""

from dataclasses import dataclass, field
from typing import Any

import torch
from torch import nn

from moveset.models.registry import describe
from moveset.training.ema import Ema
from moveset.training.engine import Task
from moveset.training.optim import cosine_lr


@dataclass(frozen=True, kw_only=True)
class NetworkConfig:
    """What is trained and how; ``kind`` is the architecture of ``model``, for whoever reads a checkpoint."""

    model: Any
    kind: str = field(init=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "kind", describe(self.model)[0])


class SingleNetworkTask(Task):
    """One network, one optimiser, a copy that follows if there is one, and a cosine from ``config.lr`` down.

    Subclasses set ``network``, the name of the attribute that holds the network, and of its files.
    """

    network: str
    config: Any
    steps: int
    optimizer: torch.optim.Optimizer
    ema: Ema | None = None

    def modules(self) -> dict[str, nn.Module]:
        return {self.network: getattr(self, self.network)}

    def averages(self) -> dict[str, nn.Module]:
        return {} if self.ema is None else {f"{self.network}_ema": self.ema.module}

    def optimizers(self) -> dict[str, torch.optim.Optimizer]:
        return {self.network: self.optimizer}

    def learning_rates(self, step: int) -> dict[str, float]:
        return {self.network: cosine_lr(step, self.config.lr, self.config.warmup, self.steps)}
