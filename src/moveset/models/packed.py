"""Inference on a processor: weights kept in oneDNN's own blocked layout, repacked once instead of at every call.

One clip is limited by reading weights and by repacking them, not by arithmetic: packed, a network call takes a fifth
less time. Results are those of the plain layers to the last bits of float32. There are no gradients.
"""

import torch
from torch import Tensor, nn

# Kinds whose modules only call their layers; others read a layer's weights, which cannot be done once they are packed.
PACKABLE = ("latent_denoiser", "timed_vae", "length_predictor")

_TYPICAL_ROWS = 16  # latent tokens of one clip; other sizes work too, this one is laid out best


def can_pack(device: torch.device | str) -> bool:
    """Whether this build of torch holds oneDNN and the device can use it (x86 and most ARM Linux: yes; macOS: no)."""
    return (
        torch.device(device).type == "cpu"
        and torch.backends.mkldnn.is_available()
        and hasattr(torch.ops.mkldnn, "_linear_pointwise")
    )


def pack(module: nn.Module) -> nn.Module:
    """Replace the float32 ``Linear`` and zero-padded ``Conv1d`` layers below ``module`` by packed ones, in place."""
    for name, child in module.named_children():
        # Exact types only: a subclass may have its weight read by its owner, as in MultiheadAttention.
        if type(child) is nn.Linear:
            setattr(module, name, PackedLinear(child))
        elif type(child) is nn.Conv1d and child.padding_mode == "zeros" and not isinstance(child.padding, str):
            setattr(module, name, PackedConv1d(child))
        else:
            pack(child)
    return module


class PackedLinear(nn.Module):
    """``nn.Linear`` for inference."""

    def __init__(self, layer: nn.Linear) -> None:
        super().__init__()
        self.weight = torch.ops.mkldnn._reorder_linear_weight(layer.weight.detach(), _TYPICAL_ROWS)
        self.bias = None if layer.bias is None else layer.bias.detach()

    def forward(self, x: Tensor) -> Tensor:
        """x (..., in) to (..., out)."""
        y: Tensor = torch.ops.mkldnn._linear_pointwise(x, self.weight, self.bias, "none", [], "")
        return y


class PackedConv1d(nn.Module):
    """``nn.Conv1d`` for inference, as a convolution over images of height 1."""

    def __init__(self, layer: nn.Conv1d) -> None:
        super().__init__()
        padding, stride, dilation = (0, layer.padding[0]), (1, layer.stride[0]), (1, layer.dilation[0])
        self.geometry = (padding, stride, dilation, layer.groups)
        weight = layer.weight.detach()[:, :, None]
        self.weight = torch.ops.mkldnn._reorder_convolution_weight(weight, *self.geometry)
        self.bias = None if layer.bias is None else layer.bias.detach()

    def forward(self, x: Tensor) -> Tensor:
        """x (B, C, T) to (B, C', T')."""
        y: Tensor = torch.ops.mkldnn._convolution_pointwise(
            x[:, :, None], self.weight, self.bias, *self.geometry, "none", [], ""
        )
        return y[:, :, 0]
