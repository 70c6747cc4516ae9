"""Light-T2M's denoiser: its size, what may not matter, and the parts that differ from stock layers."""

import json
from dataclasses import replace

import pytest
import torch
from torch import nn

from moveset.errors import FormatError, InputError
from moveset.models.light_t2m import LightT2MConfig, MaskedGroupNorm
from moveset.models.registry import build_model, describe
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


def test_published_size():
    with torch.device("meta"):
        sizes = [sum(p.numel() for p in LightT2MConfig(features=d).build().parameters()) for d in (263, 251)]
    assert sizes[0] == 4_478_471  # 4.48 M
    assert sizes[1] == sizes[0] - 12 * (256 + 257)


def test_published_shapes():
    model, taps = LightT2MConfig().build().eval(), []
    x, zero = torch.randn(1, 196, 263), torch.zeros(1, dtype=torch.long)
    with torch.no_grad():
        out = call(model, x, zero + 999, x, zero, zero, torch.randn(1, 1, 512), torch.ones(1, 1).bool(), taps=taps)
    assert out.shape == x.shape
    assert [tuple(tap.shape) for tap in taps] == [(1, 196, 256)] * 4
    torch.testing.assert_close(model.out(taps[-1]), out)


def test_gradients_reach_all_parameters(model, inputs):
    model.zero_grad()
    call(model, *inputs).square().mean().backward()
    silent = [name for name, p in model.named_parameters() if p.grad is None or p.grad.abs().max() == 0]
    model.zero_grad()
    assert silent == []


def test_padded_frames_do_not_matter(model, inputs):
    x, *rest = inputs
    mask = torch.arange(10) < torch.tensor([10, 7, 3])[:, None]
    expected = call(model, x, *rest, mask_Bn=mask)
    torn = call(model, x.masked_fill(~mask[..., None], float("nan")), *rest, mask_Bn=mask)
    torch.testing.assert_close(torn[mask], expected[mask])
    for row, frames in enumerate((10, 7, 3)):  # a clip alone, whatever its padding was: none, one patch, several
        alone = [part[row : row + 1] for part in (x[:, :frames], *rest)]
        torch.testing.assert_close(call(model, *alone), expected[row : row + 1, :frames], rtol=1e-4, atol=1e-5)
    longer = torch.cat((x, torch.zeros(3, 13, 5)), dim=1)
    padded = call(model, longer, *rest, mask_Bn=torch.cat((mask, torch.zeros(3, 13).bool()), dim=1))
    torch.testing.assert_close(padded[:, :10][mask], expected[mask], rtol=1e-4, atol=1e-5)


def test_padded_text_does_not_matter_and_a_prompt_may_be_empty(inputs):
    *start, tokens, mask = inputs
    mask[2] = False
    for pool in ("last", "mean"):
        torch.manual_seed(0)
        model = replace(TINY, pool=pool).build().eval()
        expected = call(model, *start, tokens, mask)
        assert torch.isfinite(expected).all()
        assert torch.equal(call(model, *start, tokens.masked_fill(~mask[..., None], float("nan")), mask), expected)
        pooled = torch.stack((tokens[0, 3], tokens[1, 1])) if pool == "last" else None
        pooled = torch.stack((tokens[0].mean(0), tokens[1, :2].mean(0))) if pooled is None else pooled
        torch.testing.assert_close(model.pooled(tokens, mask)[:2], pooled)
        one = call(model, *(part[:2] for part in start), pooled[:, None], torch.ones(2, 1).bool())
        torch.testing.assert_close(one, expected[:2])


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


def test_rebuilt_from_its_description(model, inputs):
    kind, stored = describe(TINY)
    twin = build_model(kind, json.loads(json.dumps(stored))).eval()
    assert (kind, twin.config) == ("light_t2m", TINY)
    twin.load_state_dict(model.state_dict())
    assert torch.equal(call(twin, *inputs), call(model, *inputs))


@pytest.mark.parametrize(
    "wrong",
    [{"features": 0}, {"width": 13}, {"groups": 5}, {"stages": 0}, {"pool": "max"}, {"dropout": 1.0}, {"patch": 65}],
    ids=str,
)
def test_bad_settings_are_one_sentence(wrong):
    with pytest.raises(InputError):
        replace(TINY, **wrong)
    with pytest.raises(FormatError):
        build_model("light_t2m", describe(TINY)[1] | wrong)
