"""Trains the length predictor: a minute on a CPU, so a plain loop without checkpoints."""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import cross_entropy

from moveset.errors import InputError
from moveset.models.length import LengthPredictor, LengthPredictorConfig


@dataclass(frozen=True)
class LengthTraining:
    """A trained predictor and how well it does on pairs that it has not seen.

    Args:
        model: in evaluation mode.
        median_error: median of ``|predicted - true|`` over the held-out pairs, frames.
        constant_error: the same for always answering the training set's median length.
    """

    model: LengthPredictor
    median_error: float
    constant_error: float


def train_length(
    pooled_NC: Tensor,
    frames_N: Tensor,
    *,
    held_out: Tensor,
    config: LengthPredictorConfig | None = None,
    epochs: int = 40,
    batch: int = 64,
    learning_rate: float = 1e-3,
    seed: int = 0,
) -> LengthTraining:
    """Cross-entropy on length classes (T2M), AdamW with a cosine schedule.

    Args:
        pooled_NC: (N, C) pooled sentence embeddings.
        frames_N: (N,) lengths of the motions they describe, frames.
        held_out: (N,) bool, pairs that are only measured. Split by take: captions of one take must stay together.
        config: sizes; by default those that fit C.
        epochs: passes over the training pairs.
        batch: pairs a step.
        learning_rate: at the start.
        seed: of the initial weights, the dropout and the order.

    Raises:
        InputError: arrays that do not belong together, or no pair on either side of the split.
    """
    held_out = held_out.bool()
    if pooled_NC.ndim != 2 or not len(pooled_NC) == len(frames_N) == len(held_out):
        raise InputError(
            f"embeddings {tuple(pooled_NC.shape)}, lengths {tuple(frames_N.shape)} and marks {tuple(held_out.shape)} "
            "do not belong together; give (N, C), (N,) and (N,)"
        )
    if held_out.all() or not held_out.any():
        raise InputError(f"{int(held_out.sum())} of {len(held_out)} pairs are held out; keep some on either side")
    generator = torch.Generator().manual_seed(seed)
    config = config or LengthPredictorConfig(text_dim=pooled_NC.shape[1])
    with torch.random.fork_rng(devices=[]):  # initial weights and dropout draw from the global generator
        torch.manual_seed(seed)
        model = config.build()
        x, y = pooled_NC[~held_out].float(), model.classes_of(frames_N[~held_out])
        optimizer = torch.optim.AdamW(model.parameters(), lr=learning_rate, weight_decay=0.01)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, epochs * -(-len(x) // batch))
        for _ in range(epochs):
            for rows in torch.randperm(len(x), generator=generator).split(batch):
                loss = cross_entropy(model(x[rows]), y[rows], label_smoothing=0.05)
                optimizer.zero_grad()
                loss.backward()
                optimizer.step()
                schedule.step()
    model.eval()
    true = frames_N[held_out].float()
    error = (model.predict(pooled_NC[held_out].float()) - true).abs()
    constant = (frames_N[~held_out].float().median() - true).abs()
    return LengthTraining(model, float(error.median()), float(constant.median()))
