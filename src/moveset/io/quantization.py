"""How weights are stored: in half precision, rounded to 8 bits, or as 8-bit differences from a network stored whole.

A student starts as its teacher and stays near it: rows of the difference, divided by their largest entry, need no more
than 8 bits for the network to compute the same to three decimals, and half the room. The difference is taken from the
base *as stored*, so that the base's own rounding does not add to the error.

A matrix without a base has 8 bits, too, with a unit of its own for every few columns of a row, as Q8_0 of GGML has.

Stored names: ``KEY`` float16, whole; or ``KEY:difference`` int8 (rows, …) and ``KEY:scale`` float32 (rows,), which
mean base + difference · scale; or ``KEY:rounded`` int8 (rows, columns) and ``KEY:scale`` float16 (rows, blocks), which
mean rounded · scale.
"""

from collections.abc import Mapping

import torch
from torch import Tensor

DIFFERENCE, ROUNDED, SCALE = ":difference", ":rounded", ":scale"
LEVELS = 127
BLOCK = 32  # columns of a matrix without a base that share a unit
# A tensor whose difference is too large for 8 bits (relative error of the tensor) is stored whole.
MAX_ERROR = 4e-3


def halved(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """All tensors whole; floating ones in half precision.

    Raises:
        ValueError: values that half precision cannot hold.
    """
    return {name: _half(name, value.detach().cpu()) for name, value in state.items()}


def subtracted(state: Mapping[str, Tensor], base: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Matrices as 8-bit differences from the base's of the same name and shape; the rest as in ``halved``.

    Args:
        state: a network's weights.
        base: another network's, as stored by ``halved`` or ``compacted``.

    Raises:
        ValueError: values that half precision cannot hold.
    """
    stored, base = halved(state), restored(base)
    for name, value in state.items():
        if name in base and value.shape == base[name].shape and _worthwhile(value):
            value = value.detach().cpu().float()
            difference, scale = _quantised(value - base[name])
            error = torch.linalg.vector_norm(_sum(base[name], difference, scale) - value)
            if error <= MAX_ERROR * torch.linalg.vector_norm(value):
                del stored[name]
                stored |= {name + DIFFERENCE: difference, name + SCALE: scale}
    return stored


def compacted(state: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """Matrices in 8 bits, every 32 columns with a unit of their own; the rest as in ``halved``.

    Raises:
        ValueError: values that half precision cannot hold.
    """
    stored = halved(state)
    for name, value in state.items():
        if value.is_floating_point() and value.ndim == 2 and value.shape[1] % BLOCK == 0:
            del stored[name]
            stored |= rounded(name, value, BLOCK)
    return stored


def rounded(name: str, matrix: Tensor, block: int) -> dict[str, Tensor]:
    """A matrix (rows, columns) in 8 bits, as it is stored; ``block`` columns, a divisor of all, share a unit."""
    integers, scale = _quantised(matrix.detach().cpu().float().reshape(-1, block), torch.float16)
    return {name + ROUNDED: integers.view(matrix.shape), name + SCALE: scale.view(len(matrix), -1)}


def unrounded(integers: Tensor, scale: Tensor) -> Tensor:
    """Rows of a rounded matrix (…, columns) and their units (…, blocks) in single precision."""
    return integers.float().unflatten(-1, (scale.shape[-1], -1)).mul_(scale.float()[..., None]).flatten(-2)


def restored(stored: Mapping[str, Tensor], base: Mapping[str, Tensor] | None = None) -> dict[str, Tensor]:
    """The weights in single precision.

    Args:
        stored: by ``halved``, ``compacted`` and ``rounded``, or by ``subtracted`` from ``base``.
        base: as stored by ``halved`` or ``compacted``.

    Raises:
        ValueError: differences from tensors that the base does not have, or not of this shape; rounded matrices
            whose units do not fit.
    """
    state: dict[str, Tensor] = {}
    base = None if base is None else restored(base)
    for name, value in stored.items():
        if name.endswith(DIFFERENCE):
            key = name.removesuffix(DIFFERENCE)
            scale = stored.get(key + SCALE)
            if base is None or key not in base or scale is None:
                raise ValueError(f"{key!r} is a difference from nothing")
            if value.dtype != torch.int8 or value.shape != base[key].shape or scale.shape != value.shape[:1]:
                raise ValueError(f"{key!r} is no difference from a tensor of shape {tuple(base[key].shape)}")
            state[key] = _sum(base[key], value, scale)
        elif name.endswith(ROUNDED):
            key = name.removesuffix(ROUNDED)
            scale = stored.get(key + SCALE)
            fits = scale is not None and scale.shape[:-1] == value.shape[:-1] and value.shape[-1] % scale.shape[-1] == 0
            if scale is None or value.dtype != torch.int8 or not fits:
                raise ValueError(f"{key!r} has no units for its rows of integers")
            state[key] = unrounded(value, scale)
        elif not name.endswith(SCALE):
            state[name] = value.float() if value.is_floating_point() else value
    return state


def _worthwhile(value: Tensor) -> bool:
    """Whether a byte an entry and four a row are fewer than two an entry."""
    return value.is_floating_point() and value.ndim >= 2 and value[0].numel() > 4


def _quantised(difference: Tensor, precision: torch.dtype = torch.float32) -> tuple[Tensor, Tensor]:
    """Integers in ±127 and the size of their unit, one a row."""
    scale = (difference.flatten(1).abs().amax(dim=1) / LEVELS).to(precision)
    unit = _column(torch.where(scale > 0, scale, 1.0).float(), difference)
    return (difference / unit).round().clamp(-LEVELS, LEVELS).to(torch.int8).contiguous(), scale


def _sum(base: Tensor, difference: Tensor, scale: Tensor) -> Tensor:
    # A product and a sum, each rounded once: the same bits wherever this is computed.
    return base + difference.float() * _column(scale, difference)


def _column(row_values: Tensor, like: Tensor) -> Tensor:
    return row_values.view(-1, *[1] * (like.ndim - 1))


def _half(name: str, value: Tensor) -> Tensor:
    if not value.is_floating_point():
        return value.contiguous()
    half = value.half().contiguous()
    if not torch.isfinite(half).all():
        raise ValueError(f"{name} has values that half precision cannot hold")
    return half
