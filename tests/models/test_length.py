"""The length predictor predicts medians."""

import torch

from moveset.models.length import LengthPredictorConfig


def test_the_median():
    model = LengthPredictorConfig(text_dim=4, width=8, classes=10).build().eval()
    with torch.no_grad():
        model.layers[-1].weight.zero_()
        model.layers[-1].bias.copy_(torch.tensor([0.1, 0, 0, 0.3, 0.2, 0.4, 0, 0, 0, 0]).clamp_min(1e-9).log())
    pooled = torch.randn(2, 4)
    assert model.predict(pooled).tolist() == [16, 16]  # class 4 holds the median, four frames a class
