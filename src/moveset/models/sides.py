"""Which sides a sentence names: a small classifier of its token states.

It learns from what motions show, not from words: sentences of people name sides now and then, and sometimes the wrong
one; those of mirror images say the opposite, so what names none is as often on the left as on the right.

Shapes: B sentences, L tokens, C width of the encoder, W width; 3 of ``motion.sides.SIDED``, and classes left, neither,
right.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from moveset.models.registry import ModelConfig, register, require_sizes
from moveset.text.encoder import TextEmbedding


@dataclass(frozen=True, kw_only=True, slots=True)
class SidePredictorConfig(ModelConfig):
    """Sizes of a ``SidePredictor``; ``least`` is by how much one side has to be likelier than the other to be said."""

    text_dim: int = 384
    width: int = 64
    dropout: float = 0.1
    least: float = 0.25

    def __post_init__(self) -> None:
        require_sizes(self, least=(0.0, 1.0))


class SidePredictor(nn.Module):
    """Logits of sides, and sides as ``text.sides`` wants them."""

    def __init__(self, config: SidePredictorConfig) -> None:
        super().__init__()
        self.config = config
        self.norm = nn.LayerNorm(config.text_dim)
        self.inner = nn.Linear(config.text_dim, config.width)
        self.weigh = nn.Linear(config.width, 3)
        self.dropout = nn.Dropout(config.dropout)
        self.out = nn.ModuleList(nn.Linear(config.width, 3) for _ in range(3))

    def forward(self, text: TextEmbedding) -> Tensor:
        """(B, 3, 3) logits."""
        hidden_BLW = nn.functional.gelu(self.inner(self.norm(text.tokens)))
        weight_BL3 = self.weigh(hidden_BLW).masked_fill(~text.mask[..., None], -1e4).softmax(dim=1)
        read_B3W = self.dropout(weight_BL3.transpose(1, 2) @ hidden_BLW)
        return torch.stack([out(read_B3W[:, k]) for k, out in enumerate(self.out)], dim=1)

    @torch.inference_mode()
    def predict(self, text: TextEmbedding) -> Tensor:
        """(B, 3) of arms, legs, turn: 1 left, -1 right, NaN where none is said."""
        share_B33 = self(text).softmax(dim=-1)
        margin_B3 = share_B33[..., 0] - share_B33[..., 2]
        return margin_B3.sign().masked_fill(margin_B3.abs() < self.config.least, torch.nan)


register("side_predictor", SidePredictorConfig, SidePredictor)
