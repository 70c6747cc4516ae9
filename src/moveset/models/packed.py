"""Inference on a processor: weights kept in oneDNN's own blocked layout, repacked once instead of at every call.

One clip is limited by reading weights, by repacking them and by the number of operations. ``pack`` gives the networks
that ship a form for inference of their own (``packed_vae``, ``packed_denoiser``), others the packed layers alone.
Results are those of the plain layers to the last bits of float32. There are no gradients.
"""

import torch
from torch import Tensor, nn

from moveset.text.packed_linear import POST, PackedLinear

# Kinds whose modules only call their layers; others read a layer's weights, which cannot be done once they are packed.
PACKABLE = ("latent_denoiser", "timed_vae", "length_predictor", "segment_transformer")


def pack(module: nn.Module) -> nn.Module:
    """The module's form for inference, float32 on a processor; the module itself is used up."""
    # Imported here because they are made of what is below.
    from moveset.models.latent_denoiser import LatentDenoiser
    from moveset.models.packed_denoiser import PackedDenoiser
    from moveset.models.packed_vae import PackedVAE
    from moveset.models.timed_vae import TimedVAE

    if isinstance(module, TimedVAE):
        return PackedVAE(module)
    return PackedDenoiser(module) if isinstance(module, LatentDenoiser) else pack_layers(module)


def pack_layers(module: nn.Module) -> nn.Module:
    """Replace the ``Linear`` layers below ``module`` by packed ones, in place."""
    for name, child in module.named_children():
        # Exact types only: a subclass may have its weight read by its owner, as in MultiheadAttention.
        if type(child) is nn.Linear:
            setattr(module, name, PackedLinear.of(child))
        else:
            pack_layers(child)
    return module


class PackedTimeConv(nn.Module):
    """A ``nn.Conv1d`` that keeps its length, on (B, T, C), with the channels last as oneDNN likes it best.

    Args:
        layer: stride 1, one group.
        gain: (C, 1) factor of each input channel.
        post: as for ``PackedLinear``.
    """

    def __init__(self, layer: nn.Conv1d, gain: Tensor | None = None, post: str = "") -> None:
        super().__init__()
        weight = layer.weight.detach() if gain is None else layer.weight.detach() * gain
        self.geometry = ((0, layer.kernel_size[0] // 2), (1, 1), (1, 1), 1)
        self.weight = torch.ops.mkldnn._reorder_convolution_weight(weight[:, :, None], *self.geometry)
        self.bias = None if layer.bias is None else layer.bias.detach()
        self._post = POST[post]

    def forward(self, x_BTC: Tensor) -> Tensor:
        """(B, T, C) to (B, T, C')."""
        y: Tensor = torch.ops.mkldnn._convolution_pointwise(
            x_BTC.transpose(1, 2)[:, :, None], self.weight, self.bias, *self.geometry, *self._post
        )
        return y[:, :, 0].transpose(1, 2)

    def plus(self, x_BTC: Tensor, other_BTC: Tensor) -> Tensor:
        """The convolution, without ``post``, plus ``other``: one operation."""
        y: Tensor = torch.ops.mkldnn._convolution_pointwise.binary(
            x_BTC.transpose(1, 2)[:, :, None], other_BTC.transpose(1, 2)[:, :, None], self.weight, self.bias,
            *self.geometry, "add", 1.0, None, [], None,
        )  # fmt: skip
        return y[:, :, 0].transpose(1, 2)
