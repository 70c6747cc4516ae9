"""Exponential moving average of a module's parameters."""

import copy

import torch
from torch import nn
from torch.optim.swa_utils import get_ema_multi_avg_fn

from moveset.models.registry import require_range


class Ema:
    """A frozen copy of a module that follows it: average ← decay · average + (1 − decay) · parameter.

    ``ema.module`` is in eval mode, takes no gradient, and is saved with the checkpoint when the task lists it in
    ``averages()``. Buffers are copied.

    Args:
        module: what to follow; the average starts as a copy of it.
        decay: in 0 to 1.

    Raises:
        InputError: a decay that is not.
    """

    def __init__(self, module: nn.Module, decay: float) -> None:
        require_range("ema", decay, 0.0, 1.0)
        self.module = copy.deepcopy(module).eval().requires_grad_(False)
        self.decay = decay

    @torch.no_grad()
    def update(self, module: nn.Module, decay: float | None = None) -> None:
        """Moves the average towards ``module``; ``decay`` overrides the constant one, e.g. by ``ema_warmup``."""
        average = get_ema_multi_avg_fn(self.decay if decay is None else decay)
        average(list(self.module.parameters()), list(module.parameters()), None)
        for mine, theirs in zip(self.module.buffers(), module.buffers(), strict=True):
            mine.copy_(theirs)


def ema_warmup(step: int, decay: float) -> float:
    """Decay that forgets the first, random weights quickly: min(decay, (1 + step) / (10 + step))."""
    return min(decay, (1 + step) / (10 + step))
