"""The length predictor predicts medians, and draws reproducibly."""

import torch

from moveset.models.length import LengthPredictorConfig


def test_median_and_draws():
    model = LengthPredictorConfig(text_dim=4, width=8, classes=10).build().eval()
    with torch.no_grad():
        model.layers[-1].weight.zero_()
        model.layers[-1].bias.copy_(torch.tensor([0.1, 0, 0, 0.3, 0.2, 0.4, 0, 0, 0, 0]).clamp_min(1e-9).log())
    pooled = torch.randn(2, 4)
    assert model.predict(pooled).tolist() == [16, 16]  # class 4 holds the median, four frames a class
    draws = [model.predict(pooled, torch.Generator().manual_seed(seed)).tolist() for seed in (0, 0, *range(40))]
    assert draws[0] == draws[1]
    assert {length for pair in draws for length in pair} == {0, 12, 16, 20}
