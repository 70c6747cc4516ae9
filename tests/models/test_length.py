"""The length predictor learns lengths from embeddings, predicts medians, and draws reproducibly."""

import pytest
import torch

from moveset.errors import InputError
from moveset.models.length import LengthPredictorConfig
from moveset.training.length import train_length


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


def test_lengths_are_learned_and_reproducible():
    generator = torch.Generator().manual_seed(0)
    pooled = torch.randn(600, 16, generator=generator)
    frames = (100 + 60 * torch.tanh(pooled[:, 0])).long()
    held_out = torch.arange(600) % 5 == 0
    first, again = (train_length(pooled, frames, held_out=held_out, epochs=15, seed=3) for _ in range(2))
    assert first.median_error < 0.5 * first.constant_error
    for a, b in zip(first.model.parameters(), again.model.parameters(), strict=True):
        assert torch.equal(a, b)


def test_training_does_not_touch_the_global_generator():
    state = torch.random.get_rng_state()
    train_length(torch.randn(10, 4), torch.full((10,), 40), held_out=torch.arange(10) < 2, epochs=1)
    pooled, frames = torch.zeros(10, 4), torch.full((10,), 40)
    torch.random.set_rng_state(state)
    before = torch.rand(1)
    torch.random.set_rng_state(state)
    train_length(pooled, frames, held_out=torch.arange(10) < 2, epochs=1)
    assert torch.equal(before, torch.rand(1))


def test_arrays_must_fit():
    with pytest.raises(InputError, match="do not belong together"):
        train_length(torch.zeros(3, 4), torch.zeros(2), held_out=torch.zeros(3))
    with pytest.raises(InputError, match="keep some on either side"):
        train_length(torch.zeros(3, 4), torch.ones(3), held_out=torch.zeros(3))
