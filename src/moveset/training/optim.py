"""Learning rates as pure functions of the step, and optimiser state as tensors and JSON instead of pickles."""

import math
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from moveset.errors import FormatError


def cosine_lr(step: int, base: float, warmup: int, total: int) -> float:
    """Learning rate of step ``step`` (1, 2, … total): linear up to ``base``, then half a cosine down to 0.

    >>> [cosine_lr(s, 1.0, 2, 6) for s in (1, 2, 4, 6)]
    [0.5, 1.0, 0.5, 0.0]
    """
    if warmup and step <= warmup:
        return base * step / warmup
    progress = min(1.0, (step - warmup) / max(1, total - warmup))
    return base * (1.0 + math.cos(math.pi * progress)) / 2.0


def flatten_optimizer(optimizer: torch.optim.Optimizer) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """State of an optimiser as tensors named ``PARAMETER/KEY`` and a JSON-able rest (groups, scalars)."""
    state = optimizer.state_dict()
    tensors, scalars = {}, {}
    for index, entry in state["state"].items():
        for key, value in entry.items():
            if isinstance(value, Tensor):
                tensors[f"{index}/{key}"] = value
            else:
                scalars[f"{index}/{key}"] = value
    return tensors, {"param_groups": state["param_groups"], "scalars": scalars}


def unflatten_optimizer(
    optimizer: torch.optim.Optimizer, tensors: Mapping[str, Tensor], rest: Mapping[str, Any]
) -> None:
    """Loads the moments of what ``flatten_optimizer`` gave.

    Hyper-parameters stay those that the optimiser was made with: whoever resumes with other settings means these. No
    optimiser of ours keeps anything else in its groups.

    Raises:
        FormatError: the state belongs to other parameters.
    """
    shapes = [parameter.shape for group in optimizer.param_groups for parameter in group["params"]]
    state: dict[int, dict[str, Any]] = {}
    for name, value in (*tensors.items(), *rest["scalars"].items()):
        index, _, key = name.partition("/")
        fits = index.isdigit() and int(index) < len(shapes)
        if not fits or (isinstance(value, Tensor) and value.ndim > 0 and value.shape != shapes[int(index)]):
            raise FormatError(f"optimiser state {name!r} belongs to another model; check the recipe")
        state.setdefault(int(index), {})[key] = value
    try:
        own = optimizer.state_dict()["param_groups"]
        groups = [{**mine, "params": stored["params"]} for mine, stored in zip(own, rest["param_groups"], strict=True)]
        optimizer.load_state_dict({"state": state, "param_groups": groups})
    except ValueError as error:
        raise FormatError(f"optimiser state belongs to another model ({error}); check the recipe") from error
