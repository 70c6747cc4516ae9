from dataclasses import replace

import pytest
import torch

from moveset.errors import InputError
from moveset.models.discriminator import DiscriminatorConfig
from moveset.models.token_denoiser import TokenDenoiserConfig
from tests.conditions import condition_of

TINY = TokenDenoiserConfig(
    token_dim=4, text_dim=6, width=16, layers=3, heads=2, feed_forward=32, positions=30, time_waves=24, guidance_waves=8
)


@pytest.fixture
def inputs():
    g = torch.Generator().manual_seed(0)
    z, tokens = torch.randn(3, 5, 4, generator=g), torch.randn(3, 4, 6, generator=g)
    return z, torch.tensor([0, 499, 999]), condition_of(tokens, torch.arange(4) < torch.tensor([4, 2, 1])[:, None])


def scaled(inputs, w):
    z, t, condition = inputs
    return z, t, replace(condition, scale=torch.as_tensor(w).expand(len(z)))


def test_published_shapes():
    model, taps = TokenDenoiserConfig(guided=True).build().eval(), []
    z, t, w = torch.randn(2, 16, 32), torch.tensor([999, 499]), torch.tensor([7.0, 11.5])
    eps = model(z, t, condition_of(torch.randn(2, 12, 768), scale=w), taps)
    assert eps.shape == z.shape
    assert [tuple(tap.shape) for tap in taps] == [(2, 16, 256)] * 9
    torch.testing.assert_close(model.latent_out(model.stack.norm(taps[-1])), eps)


def test_time_and_text_matter(inputs):
    z, t, condition = inputs
    model = TINY.build().eval()
    base = model(z, t, condition)
    assert not torch.allclose(model(z, t + 1, condition)[0], base[0], atol=1e-6)
    other = condition_of(condition.text.tokens.roll(1, 0), condition.text.mask)
    assert not torch.allclose(model(z, t, other), base, atol=1e-6)


def test_too_much_text_is_one_sentence():
    with pytest.raises(InputError, match="positions"):
        TINY.build()(torch.zeros(1, 5, 4), torch.tensor([1]), condition_of(torch.zeros(1, 25, 6)))


def test_it_serves_as_the_discriminator_s_backbone(inputs):
    z, t, condition = inputs
    heads = DiscriminatorConfig(width=16, taps=3, groups=4).build()
    backbone, taps = TINY.build().requires_grad_(False), []
    z = z.requires_grad_()
    backbone(z, t, condition, taps)
    logits = heads(taps)
    assert logits.shape == (3, 5, 3)
    logits.mean().backward()
    assert (z.grad.flatten(1).abs().amax(1) > 0).all()
