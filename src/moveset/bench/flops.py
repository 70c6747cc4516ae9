"""How many operations a piece of work takes: two for a multiplication and an addition, in products and convolutions.

``torch.utils.flop_counter`` counts, taught the operations of oneDNN that inference on a processor is made of
(``models.packed``), and LSTMs. Norms, activations and what is no product are not counted, as everywhere in the field.
"""

from collections.abc import Callable
from math import prod
from typing import Any

import torch
from torch.nn.attention import SDPBackend, sdpa_kernel
from torch.utils.flop_counter import FlopCounterMode

Shape = list[int]


def counter() -> FlopCounterMode:
    """A counter that knows oneDNN's operations; the fused attention of processors must be off, as in ``counted``."""
    operations: dict[Any, Any] = {torch.ops.aten.mkldnn_rnn_layer: _lstm, torch.ops.aten._cudnn_rnn: _cudnn_lstm}
    if hasattr(torch.ops.mkldnn, "_linear_pointwise"):
        operations[torch.ops.mkldnn._linear_pointwise] = _linear
        operations[torch.ops.mkldnn._convolution_pointwise] = _convolution
    return FlopCounterMode(display=False, custom_mapping=operations)


def counted(work: Callable[[], object]) -> int:
    """The operations of one call; it takes much longer than usual."""
    found = counter()
    with sdpa_kernel(SDPBackend.MATH), found:
        work()
    return int(found.get_total_flops())


def _linear(x: Shape, *_: object, out_shape: Shape, **__: object) -> int:
    return 2 * prod(x) * out_shape[-1]


def _convolution(x: Shape, second: Shape, third: Shape | None, *_: object, out_shape: Shape, **__: object) -> int:
    # With a sum within, its other summand, which has the shape of the result, comes before the weight.
    weight = third if third is not None and len(third) >= 4 else second
    return 2 * prod(out_shape) * prod(weight) // out_shape[1]


def _lstm(x: Shape, weight: Shape, recurrent: Shape, *_: object, **__: object) -> int:
    """All four gates of every frame read input and state."""
    return 2 * x[0] * x[1] * weight[0] * (weight[1] + recurrent[1])


def _cudnn_lstm(x: Shape, weights: list[Shape], *_: object, **__: object) -> int:
    """The same, of layers with their weights in a list, between biases."""
    return 2 * x[0] * x[1] * sum(prod(weight) for weight in weights if len(weight) == 2)
