"""A segment network made even-handed: what it makes of the mirror image counts as much as of the original.

A corpus with all its mirror images leans to neither side, but a network trained on it does a little, and a stream sums
that up: a walk that bends by 4 degrees a second goes in circles.
Shapes: B rows, n frames of a segment, D features, L text tokens, C text width.
"""

from typing import Any

import torch
from torch import Tensor, nn


class Symmetric(nn.Module):
    """A network whose segments are on average over their frames as the network has them left to right and mirrored.

    Both rows are one batch. Only the means are shared: averaged frame by frame, two slightly different strides would
    blur to one of neither, and the feet would slide.

    Args:
        network: a denoiser that reads text and previous segment apart from denoising, such as ``SegmentTransformer``.
        order: (D,) which feature stands where in a mirrored motion (``NativeCodec.mirror``), and
        signs: (D,) its sign; of normalised features, whose statistics are those of a corpus with its mirror images.
    """

    def __init__(self, network: nn.Module, order: Tensor, signs: Tensor) -> None:
        super().__init__()
        self.network: Any = network
        self.register_buffer("order", order, persistent=False)
        self.register_buffer("signs", signs, persistent=False)
        self.config = network.config
        self.colour = getattr(network, "colour", None)

    def read(
        self, tokens_BLC: Tensor, mask_BL: Tensor, prev_BnD: Tensor, prev_t_B: Tensor, index_B: Tensor,
        place_B2: Tensor | None = None, turned_B: Tensor | None = None,
    ) -> object:  # fmt: skip
        """As the network's own, with 2 B rows of text: the sentences, and below them their mirror images."""
        prev_BnD = torch.cat((prev_BnD, self.flipped(prev_BnD)))
        told = {} if place_B2 is None else {"place_B2": place_B2.repeat(2, 1)}
        if turned_B is not None:
            told["turned_B"] = torch.cat((turned_B, -turned_B))
        return self.network.read(tokens_BLC, mask_BL, prev_BnD, prev_t_B.repeat(2), index_B.repeat(2), **told)

    def denoise(self, x_BnD: Tensor, t_B: Tensor, context: object, w_B: Tensor | None) -> Tensor:
        """Clean segments (B, n, D)."""
        scale = None if w_B is None else w_B.repeat(2)
        made, mirrored = self.network.denoise(
            torch.cat((x_BnD, self.flipped(x_BnD))), t_B.repeat(2), context, scale
        ).chunk(2)
        return made + 0.5 * (self.flipped(mirrored) - made).mean(dim=1, keepdim=True)

    def forward(
        self, x_BnD: Tensor, t_B: Tensor, prev_BnD: Tensor, prev_t_B: Tensor, index_B: Tensor, tokens_BLC: Tensor,
        mask_BL: Tensor, w_B: Tensor | None = None, *, place_B2: Tensor | None = None, turned_B: Tensor | None = None,
    ) -> Tensor:  # fmt: skip
        """Clean segments (B, n, D), with 2 B rows of text as in ``read``."""
        context = self.read(tokens_BLC, mask_BL, prev_BnD, prev_t_B, index_B, place_B2, turned_B)
        return self.denoise(x_BnD, t_B, context, w_B)

    def flipped(self, x_BnD: Tensor) -> Tensor:
        """The mirror images of segments."""
        return x_BnD[..., self.order] * self.signs
