"""What batches have in common, whatever their samples are."""

from dataclasses import fields
from typing import Any, Self

import torch
from torch import Tensor


class Batch:
    """A base of dataclasses of tensors and lists, all with an entry for every sample."""

    def rows(self, count: int) -> Self:
        """The first ``count`` samples."""
        return type(self)(*(held[:count] for held in self._held()))

    def to(self, device: torch.device | str) -> Self:
        return type(self)(*(held.to(device) if isinstance(held, Tensor) else held for held in self._held()))

    def _held(self) -> list[Any]:
        return [getattr(self, field.name) for field in fields(self)]  # type: ignore[arg-type]
