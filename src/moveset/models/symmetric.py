"""A segment network made even-handed: what it makes of the mirror image counts as much as of the original.

A corpus with all its mirror images leans to neither side, but a network trained on it does a little, and a stream sums
that up: a walk that bends by 4 degrees a second goes in circles.
Shapes: B rows, n frames of a segment, D features, L text tokens, C text width.
"""

from dataclasses import replace
from typing import Any

import torch
from torch import Tensor, nn

from moveset.errors import InputError
from moveset.models.condition import Condition, Denoiser, PastSegment


class Symmetric(Denoiser):
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

    def prepare(self, condition: Condition) -> Any:
        """As the network's own, of 2 B rows: the segments, and below them their mirror images."""
        past = condition.past
        if past is None or condition.mirror_text is None:
            raise InputError("a network averaged with its mirror image needs a past and what the mirror image is told")
        heading = past.heading_change
        mirrored_heading = None if heading is None else -heading
        image = PastSegment(self.flipped(past.frames), past.level, past.index, mirrored_heading)
        mirrored = replace(condition, text=condition.mirror_text, past=image, mirror_text=None)
        return self.network.prepare(replace(condition, mirror_text=None).joined(mirrored))

    def denoise(self, x_BnD: Tensor, t_B: Tensor, prepared: Any, taps: list[Tensor] | None) -> Tensor:
        """Clean segments (B, n, D)."""
        made, mirrored = self.network(torch.cat((x_BnD, self.flipped(x_BnD))), t_B.repeat(2), prepared, taps).chunk(2)
        return made + 0.5 * (self.flipped(mirrored) - made).mean(dim=1, keepdim=True)

    def flipped(self, x_BnD: Tensor) -> Tensor:
        """The mirror images of segments."""
        return x_BnD[..., self.order] * self.signs
