"""Trained networks as the next stage uses them: in evaluation mode, without gradients, known by their weights' hash."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import nn

from moveset.errors import InputError
from moveset.models import (  # noqa: F401  (they register their kinds)
    dip_decoder,
    evaluator,
    flow,
    latent_denoiser,
    light_t2m,
    segment_denoiser,
    segment_transformer,
    timed_vae,
    token_denoiser,
    token_vae,
)
from moveset.models.registry import build_model
from moveset.training import checkpoint


@dataclass(frozen=True, eq=False)
class TrainedNetwork:
    """A network of a checkpoint.

    Args:
        module: in evaluation mode, parameters without gradient.
        kind: its name in the registry of models.
        task: the configuration of its training.
        digest: sha256 of its weights file; of an average, of the digests of all.
        path: the checkpoint it is from.
    """

    module: Any
    kind: str
    config: dict[str, Any]
    task: dict[str, Any]
    digest: str
    path: Path


def load_trained(path: Path, name: str, device: torch.device | str = "cpu", part: str = "") -> TrainedNetwork:
    """The network saved as ``NAME.safetensors`` in a run folder's latest checkpoint, or in the checkpoint given.

    Args:
        part: for a task's second network, its kind: the sizes are then the task's field of the first word of ``name``
            ("flow_ema" of kind "coupling_flow" is described by ``flow``).

    Raises:
        InputError: there is no checkpoint, or it holds no such network.
        FormatError: it is damaged.
    """
    step = checkpoint.resolve(path)
    task = checkpoint.read_document(step, "config")["config"]
    kind, config = (part, task[name.split("_")[0]]) if part else (task["kind"], task["model"])
    module: nn.Module = build_model(kind, config)
    checkpoint.load_module(module, step, name)
    digest = checkpoint.verify(step)["files"][f"{name}.safetensors"]["sha256"]
    return TrainedNetwork(module.eval().requires_grad_(False).to(device), kind, config, task, digest, step)


def average_weights(name: str, networks: Sequence[TrainedNetwork]) -> TrainedNetwork:
    """The first of these networks with the mean of all their weights, which suits runs that began alike.

    Args:
        name: what it is to be, for the error.
        networks: one or more; the first one's module is changed.

    Raises:
        InputError: networks of different sizes, or of different whole numbers, such as the order of a flow's features.

    Source: model soups (arXiv 2203.05482).
    """
    first = networks[0]
    if len(networks) == 1:
        return first
    states = [network.module.state_dict() for network in networks]
    if any({k: v.shape for k, v in one.items()} != {k: v.shape for k, v in states[0].items()} for one in states):
        raise InputError(f"{name!r} is to be the mean of networks of different sizes; give runs of one architecture")
    average = {}
    for key, value in states[0].items():
        values = torch.stack([one[key] for one in states])
        if value.is_floating_point():
            average[key] = values.float().mean(0)
        elif bool((values != value).any()):
            raise InputError(f"{name!r} is to be the mean of networks of other {key}; give runs that began alike")
    first.module.load_state_dict(states[0] | average)
    digests = "".join(network.digest for network in networks)
    return replace(first, digest=hashlib.sha256(digests.encode()).hexdigest())
