"""Conditions of made-up text."""

import torch
from torch import Tensor

from moveset.models.condition import Condition
from moveset.text.encoder import TextEmbedding


def condition_of(tokens: Tensor, mask: Tensor | None = None, **parts: Tensor) -> Condition:
    """Of token states (B, L, C), all of them real unless a mask (B, L) says which."""
    mask = torch.ones(tokens.shape[:2], dtype=torch.bool) if mask is None else mask
    return Condition(TextEmbedding(tokens, mask, tokens.mean(1)), **parts)
