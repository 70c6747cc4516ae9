"""What a stream remembers, in one file: numbers as JSON, tensors as safetensors, guarded by a sha256. No pickle."""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor

from moveset.errors import FormatError
from moveset.io.limits import atomic_write, read_limited

_FORMAT = "moveset stream 1"
_MAX_BYTES = 256 * 2**20


@dataclass(frozen=True, eq=False)
class Snapshot:
    """A stream between two segments.

    Args:
        numbers: everything but the tensors, for JSON, which keeps every bit of them.
    """

    numbers: dict[str, Any]
    tensors: dict[str, Tensor]

    def save(self, path: str | Path) -> Path:
        """Write to a file, whole or not at all.

        Raises:
            InputError: a path that cannot be written to.
        """
        tensors = {name: x.detach().cpu().contiguous() for name, x in self.tensors.items()}
        text = json.dumps(self.numbers)
        notes = {"format": _FORMAT, "state": text, "sha256": _digest(text, tensors)}
        with atomic_write(path) as file:
            file.write(save(tensors, notes))
        return Path(path)

    @classmethod
    def load(cls, path: str | Path) -> "Snapshot":
        """Read a file.

        Raises:
            InputError: a file that cannot be read.
            FormatError: no such state, or a damaged one.
        """
        data = read_limited(path, _MAX_BYTES)
        try:
            tensors = load(data)
            notes = json.loads(data[8 : 8 + int.from_bytes(data[:8], "little")])["__metadata__"]
            if notes["format"] != _FORMAT or notes["sha256"] != _digest(notes["state"], tensors):
                raise ValueError("another format, or damaged")
            numbers = json.loads(notes["state"])
        except (SafetensorError, ValueError, KeyError, TypeError, RecursionError) as error:
            raise FormatError(f"{path} is no state of a stream or it is damaged; save it again") from error
        return cls(numbers, tensors)


def _digest(text: str, tensors: dict[str, Tensor]) -> str:
    found = hashlib.sha256(text.encode())
    for name in sorted(tensors):
        x = tensors[name]
        found.update(f"{name} {x.dtype} {tuple(x.shape)}".encode())
        found.update(x.flatten().view(torch.uint8).numpy().tobytes())
    return found.hexdigest()
