"""Light-T2M's denoiser: its size, what may not matter, and the parts that differ from stock layers."""

from dataclasses import replace

import pytest
import torch
from torch import nn

from moveset.errors import InputError
from moveset.models.light_t2m import LightT2MConfig, MaskedGroupNorm
from tests.conditions import call

TINY = LightT2MConfig(features=5, frames=24, text_dim=6, width=12, stages=2, patch=4, groups=3, states=4, rank=2)


@pytest.fixture(scope="module")
def model():
    torch.manual_seed(0)
    return TINY.build().eval()


@pytest.fixture
def inputs():
    g = torch.Generator().manual_seed(1)
    x, tokens = torch.randn(3, 10, 5, generator=g), torch.randn(3, 4, 6, generator=g)
    mask, zero = torch.arange(4) < torch.tensor([4, 2, 1])[:, None], torch.zeros(3, dtype=torch.long)
    return x, torch.tensor([1, 500, 1000]), x, zero, zero, tokens, mask


def test_published_shapes():
    model, taps = LightT2MConfig().build().eval(), []
    x, zero = torch.randn(1, 196, 263), torch.zeros(1, dtype=torch.long)
    with torch.no_grad():
        out = call(model, x, zero + 999, x, zero, zero, torch.randn(1, 1, 512), torch.ones(1, 1).bool(), taps=taps)
    assert out.shape == x.shape
    assert [tuple(tap.shape) for tap in taps] == [(1, 196, 256)] * 4
    torch.testing.assert_close(model.out(taps[-1]), out)


def test_text_is_pooled_as_told(inputs):
    *start, tokens, mask = inputs
    last, mean = torch.stack((tokens[0, 3], tokens[1, 1])), torch.stack((tokens[0].mean(0), tokens[1, :2].mean(0)))
    for pool, pooled in (("last", last), ("mean", mean)):
        torch.manual_seed(0)
        model = replace(TINY, pool=pool).build().eval()
        torch.testing.assert_close(model.pooled(tokens, mask)[:2], pooled)
        one = call(model, *(part[:2] for part in start), pooled[:, None], torch.ones(2, 1).bool())
        torch.testing.assert_close(one, call(model, *start, tokens, mask)[:2])


def test_every_frame_sees_the_whole_clip_the_time_and_the_text(model, inputs):
    x, t, prev, prev_t, index, tokens, mask = inputs
    base = call(model, x, t, prev, prev_t, index, tokens, mask)
    changes = [(x + torch.eye(10)[0][:, None], t, tokens), (x + torch.eye(10)[9][:, None], t, tokens)]
    for other_x, other_t, other_tokens in [*changes, (x, t + 100, tokens), (x, t, -tokens)]:
        moved = (call(model, other_x, other_t, prev, prev_t, index, other_tokens, mask) - base).abs().amax(dim=-1)
        assert (moved > 0).all()


def test_the_previous_segment_is_no_input(model, inputs):
    x, t, prev, prev_t, *rest = inputs
    assert torch.equal(call(model, x, t, prev * float("nan"), prev_t + 5, *rest), call(model, *inputs))


def test_requests_it_cannot_serve_are_one_sentence(model, inputs):
    x, t, prev, prev_t, index, tokens, mask = inputs
    with pytest.raises(InputError, match="segment 3 was asked for"):
        call(model, x, t, prev, prev_t, torch.tensor([0, 3, 1]), tokens, mask)
    with pytest.raises(InputError, match="guidance"):
        call(model, *inputs, torch.ones(3))
    with pytest.raises(InputError, match="30 frames exceeds the model's 24"):
        call(model, x.repeat(1, 3, 1), t, prev, prev_t, index, tokens, mask)


def test_group_normalisation_counts_what_is_there():
    torch.manual_seed(0)
    norm, stock = MaskedGroupNorm(3, 12), nn.GroupNorm(3, 12)
    for parameter in norm.parameters():
        nn.init.normal_(parameter)
    stock.load_state_dict(norm.state_dict())
    x = torch.randn(2, 12, 7)
    torch.testing.assert_close(norm(x, torch.ones(2, 7).bool()), stock(x))
    mask = torch.arange(7) < torch.tensor([[7], [4]])
    out = norm(x, mask)
    torch.testing.assert_close(out[:1], stock(x[:1]))
    torch.testing.assert_close(out[1:, :, :4], stock(x[1:, :, :4]))
