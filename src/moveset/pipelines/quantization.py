"""How weights are stored: in half precision, or as 8-bit differences from those of a network that is stored whole.

A student starts as its teacher and stays near it: rows of the difference, divided by their largest entry, need no more
than 8 bits for the network to compute the same to three decimals, and half the room. The difference is taken from the
base *as stored*, so that the base's own rounding does not add to the error.

Stored names: ``KEY`` float16, whole; or ``KEY:difference`` int8 (rows, …) and ``KEY:scale`` float32 (rows,), which
mean base + difference · scale.
"""

from collections.abc import Mapping

import torch
from torch import Tensor

DIFFERENCE, SCALE = ":difference", ":scale"
LEVELS = 127
# A tensor whose difference is too large for 8 bits (relative error of the tensor) is stored whole.
MAX_ERROR = 4e-3


def halved(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """All tensors whole; floating ones in half precision.

    Raises:
        ValueError: values that half precision cannot hold.
    """
    return {name: _half(name, value.detach().cpu()) for name, value in state.items()}


def subtracted(
    state: Mapping[str, Tensor], base: Mapping[str, Tensor], max_error: float = MAX_ERROR
) -> dict[str, Tensor]:
    """Matrices as 8-bit differences from the base's of the same name and shape; the rest as in ``halved``.

    Args:
        state: a network's weights.
        base: another network's, as stored by ``halved``.
        max_error: a matrix that its difference would miss by more than this, relative to its norm, is stored whole.

    Raises:
        ValueError: values that half precision cannot hold.
    """
    stored = halved(state)
    for name, value in state.items():
        if name in base and value.shape == base[name].shape and _worthwhile(value):
            value = value.detach().cpu().float()
            difference, scale = _quantised(value - base[name].float())
            error = torch.linalg.vector_norm(_sum(base[name], difference, scale) - value)
            if error <= max_error * torch.linalg.vector_norm(value):
                del stored[name]
                stored |= {name + DIFFERENCE: difference, name + SCALE: scale}
    return stored


def restored(stored: Mapping[str, Tensor], base: Mapping[str, Tensor] | None = None) -> dict[str, Tensor]:
    """The weights in single precision.

    Args:
        stored: by ``halved``, or by ``subtracted`` from ``base``.
        base: as stored by ``halved``.

    Raises:
        ValueError: differences from tensors that the base does not have, or not of this shape.
    """
    state: dict[str, Tensor] = {}
    for name, value in stored.items():
        if name.endswith(DIFFERENCE):
            key = name.removesuffix(DIFFERENCE)
            scale = stored.get(key + SCALE)
            if base is None or key not in base or scale is None:
                raise ValueError(f"{key!r} is a difference from nothing")
            if value.dtype != torch.int8 or value.shape != base[key].shape or scale.shape != value.shape[:1]:
                raise ValueError(f"{key!r} is no difference from a tensor of shape {tuple(base[key].shape)}")
            state[key] = _sum(base[key], value, scale)
        elif not name.endswith(SCALE):
            state[name] = value.float() if value.is_floating_point() else value
    return state


def _worthwhile(value: Tensor) -> bool:
    """Whether a byte an entry and four a row are fewer than two an entry."""
    return value.is_floating_point() and value.ndim >= 2 and value[0].numel() > 4


def _quantised(difference: Tensor) -> tuple[Tensor, Tensor]:
    """Integers in ±127 and the size of their unit, one a row."""
    scale = difference.flatten(1).abs().amax(dim=1) / LEVELS
    unit = _column(torch.where(scale > 0, scale, 1.0), difference)
    return (difference / unit).round().clamp(-LEVELS, LEVELS).to(torch.int8).contiguous(), scale


def _sum(base: Tensor, difference: Tensor, scale: Tensor) -> Tensor:
    # A product and a sum, each rounded once: the same bits wherever this is computed.
    return base.float() + difference.float() * _column(scale, difference)


def _column(row_values: Tensor, like: Tensor) -> Tensor:
    return row_values.view(-1, *[1] * (like.ndim - 1))


def _half(name: str, value: Tensor) -> Tensor:
    if not value.is_floating_point():
        return value.contiguous()
    half = value.half().contiguous()
    if not torch.isfinite(half).all():
        raise ValueError(f"{name} has values that half precision cannot hold")
    return half
