"""How long a motion its text asks for: a small classifier on the pooled sentence embedding.

As in T2M (Guo et al. 2022) the length is one of 50 classes of four frames; unlike there, the sentence encoder is the
frozen one that also conditions the generator, so a few thousand captions and a minute on a CPU are enough.

Shapes: B sentences, C width of the pooled embedding, K classes.
"""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from moveset.models.registry import ModelConfig, register, require_sizes


@dataclass(frozen=True, kw_only=True, slots=True)
class LengthPredictorConfig(ModelConfig):
    """Sizes of a ``LengthPredictor``: class k stands for ``k * frames_per_class`` frames."""

    text_dim: int = 384
    width: int = 256
    classes: int = 50
    frames_per_class: int = 4
    dropout: float = 0.2

    def __post_init__(self) -> None:
        require_sizes(self, classes=(2, 10_000))


class LengthPredictor(nn.Module):
    """Logits over length classes, and lengths in frames."""

    def __init__(self, config: LengthPredictorConfig) -> None:
        super().__init__()
        self.config = config
        self.layers = nn.Sequential(
            # Normalised first: encoders differ in whether their pooled vector has unit length.
            nn.LayerNorm(config.text_dim),
            nn.Linear(config.text_dim, config.width),
            nn.LayerNorm(config.width),
            nn.LeakyReLU(0.2),
            nn.Dropout(config.dropout),
            nn.Linear(config.width, config.classes),
        )

    def forward(self, pooled_BC: Tensor) -> Tensor:
        """Logits (B, K) of sentences (B, C)."""
        logits: Tensor = self.layers(pooled_BC)
        return logits

    def classes_of(self, frames: Tensor) -> Tensor:
        """Class (B,) of lengths (B,) in frames; lengths beyond the last class belong to it."""
        return (frames // self.config.frames_per_class).clamp(0, self.config.classes - 1)

    @torch.inference_mode()
    def predict(self, pooled_BC: Tensor) -> Tensor:
        """Frames (B,) int64: the median of the predicted distribution."""
        share_BK = self(pooled_BC).softmax(dim=-1)
        classes_B = (share_BK.cumsum(dim=-1) < 0.5).sum(dim=-1).clamp(max=self.config.classes - 1)
        return classes_B * self.config.frames_per_class


register("length_predictor", LengthPredictorConfig, LengthPredictor)
