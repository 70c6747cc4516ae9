"""Trained networks as the next stage uses them: in evaluation mode, without gradients, known by their weights' hash."""

import warnings
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import torch
from torch import nn

from moveset.data.dataset import Dataset
from moveset.errors import InputError
from moveset.models.registry import build_model
from moveset.training import checkpoint


@dataclass(frozen=True, eq=False)
class TrainedNetwork:
    """A network of a checkpoint.

    Args:
        module: in evaluation mode, parameters without gradient.
        kind: its name in the registry of models.
        task: the configuration of its training.
        digest: sha256 of its weights file.
        path: the checkpoint it is from.
        learned_from: hashes of what its training was given, by ``Loop.learned_from``; those of older ones have none.
    """

    module: Any
    kind: str
    config: dict[str, Any]
    task: dict[str, Any]
    digest: str
    path: Path
    learned_from: dict[str, str] = field(default_factory=dict)


def require_same_encoder(config: Any, teacher: TrainedNetwork) -> None:
    """Raises InputError for a student's task that reads sentences by another text encoder than its teacher."""
    if config.text_encoder != (known := teacher.task["text_encoder"]):
        raise InputError(f"{teacher.path} knows sentences as {known!r} encodes them; set text_encoder to that")


def require_learned_from(network: TrainedNetwork, what: str, of: str, hint: str) -> None:
    """Raises InputError for a network that is known to be of another ``what`` ("vae", "flow") than the one hashed."""
    if network.learned_from.get(what, of) != of:
        raise InputError(f"{network.path} was trained with another {what}; {hint}")


def warn_of_another_corpus(networks: Iterable[TrainedNetwork], dataset: Dataset) -> None:
    """Features are scaled by a corpus's own statistics, so a network that is known to be of another sees them askew."""
    here = dataset.fingerprint
    if others := [str(network.path) for network in networks if network.learned_from.get("corpus", here) != here]:
        warnings.warn(f"trained on another corpus than this one: {', '.join(others)}", stacklevel=3)


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
    document = checkpoint.read_document(step, "config")
    task = document["config"]
    kind, config = (part, task[name.split("_")[0]]) if part else (task["kind"], task["model"])
    module: nn.Module = build_model(kind, config)
    checkpoint.load_module(module, step, name)
    digest = checkpoint.read_document(step, "manifest")["files"][f"{name}.safetensors"]["sha256"]
    module = module.eval().requires_grad_(False).to(device)
    return TrainedNetwork(module, kind, config, task, digest, step, document.get("learned_from", {}))
