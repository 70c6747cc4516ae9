"""Linear maps for inference on a processor: weights kept in oneDNN's own blocked layout, repacked once.

Few rows are limited by reading the weights: half the time of a plain product for a dozen of them, and never slower.
Results are those of the plain layer to the last bits of float32. There are no gradients.
"""

import torch
from torch import Tensor, nn
from torch.nn.functional import gelu, linear

_TYPICAL_ROWS = 16  # tokens of a sentence, of a clip's latent; other sizes work too, this one is laid out best
POST = {
    "": ("none", [], ""),
    "gelu": ("gelu", [], "none"),
    "tanh_gelu": ("gelu", [], "tanh"),
}


def can_pack(device: torch.device | str) -> bool:
    """Whether this build of torch holds oneDNN and the device can use it (x86 and most ARM Linux: yes; macOS: no)."""
    return (
        torch.device(device).type == "cpu"
        and torch.backends.mkldnn.is_available()
        and hasattr(torch.ops.mkldnn, "_linear_pointwise")
    )


class PackedLinear(nn.Module):
    """``nn.Linear`` for inference, with what follows it.

    Args:
        weight: (out, in).
        bias: (out,).
        post: "gelu", "tanh_gelu" or nothing.
    """

    def __init__(self, weight: Tensor, bias: Tensor | None, post: str = "") -> None:
        super().__init__()
        self.weight = torch.ops.mkldnn._reorder_linear_weight(weight.detach().contiguous(), _TYPICAL_ROWS)
        self.bias = None if bias is None else bias.detach()
        self._post = POST[post]

    @classmethod
    def of(cls, layer: nn.Linear, post: str = "") -> "PackedLinear":
        return cls(layer.weight, layer.bias, post)

    def forward(self, x: Tensor) -> Tensor:
        """x (..., in) to (..., out)."""
        y: Tensor = torch.ops.mkldnn._linear_pointwise(x, self.weight, self.bias, *self._post)
        return y

    def plus(self, x: Tensor, other: Tensor) -> Tensor:
        """The product, without ``post``, plus ``other`` (..., out): one operation."""
        y: Tensor = torch.ops.mkldnn._linear_pointwise.binary(x, other, self.weight, self.bias, "add")
        return y


class PlainLinear:
    """The same where nothing can be packed, of which ``post`` is "gelu" or nothing."""

    def __init__(self, weight: Tensor, bias: Tensor, post: str = "") -> None:
        self.weight, self.bias, self._post = weight, bias, post

    def __call__(self, x: Tensor) -> Tensor:
        y = linear(x, self.weight, self.bias)
        return gelu(y) if self._post else y

    def plus(self, x: Tensor, other: Tensor) -> Tensor:
        return other + linear(x, self.weight, self.bias)
