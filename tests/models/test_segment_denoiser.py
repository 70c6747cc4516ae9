"""The published segment denoiser: its sizes, its cost, what it may look at, and linear attention by its formula."""

import math
from dataclasses import replace
from functools import cache

import pytest
import torch
from torch.utils.flop_counter import FlopCounterMode

from moveset.errors import InputError
from moveset.models.condition import PastSegment
from moveset.models.segment_denoiser import SegmentDenoiserConfig, linear_attention
from tests.conditions import awake, call, condition_of

TINY = SegmentDenoiserConfig(
    features=5, frames=8, text_dim=6, width=16, layers=2, heads=2, feed_forward=24, conditioning=20, text_width=12,
    text_layers=1, text_heads=2, text_feed_forward=16, prev_width=10, guidance_waves=8,
)  # fmt: skip
RECURRENT = replace(TINY, prev="xattn", max_index=2, boundary=2)
KIT = SegmentDenoiserConfig(features=251)


@pytest.fixture
def inputs():
    g = torch.Generator().manual_seed(1)
    x, prev, tokens = (torch.randn(4, *s, generator=g) for s in ((8, 5), (8, 5), (7, 6)))
    mask = torch.arange(7) < torch.tensor([7, 4, 1, 5])[:, None]
    times = torch.tensor([0, 3, 500, 1000])
    return x, times, prev, torch.tensor([9, 0, 0, 700]), torch.tensor([0, 0, 1, 5]), tokens, mask


def parameters(module):
    return sum(p.numel() for p in module.parameters())


def on_meta(config):
    with torch.device("meta"):
        return config.build()


def test_published_sizes():
    model = on_meta(SegmentDenoiserConfig())
    text = sum(parameters(getattr(model, name)) for name in ("text_in", "text_blocks", "text_norm", "text_summary"))
    assert text == 5_918_464  # 5.9 M
    assert parameters(model) - text == 81_233_671  # 81.2 M
    # KIT-ML's twelve features less, in and out.
    assert parameters(model) - parameters(on_meta(KIT)) == 12 * (512 + 513)
    stylization = sum(p.numel() for name, p in model.named_parameters() if ".modulate." in name)
    assert stylization == 8 * 3 * 2049 * 1024  # 50 M of it
    small = on_meta(replace(KIT, frames=28, text_dim=384, prev="xattn", max_index=1))
    assert parameters(small) - parameters(on_meta(replace(KIT, frames=28, text_dim=384))) == (
        8 * (2049 * 1024 + 1024 + 2 * 513 * 512 + 1024 + 512 + 2 * 257 * 512)  # one cross-attention a layer
        + (252 + 28 + 513 + 257 + 1) * 256  # the previous segment's encoding
        + (513 + 2049) * 2048  # the segment number's
    )


@cache
def flops(config, frames, text_tokens=77):
    # A call finds its text read, so the text layers do not count.
    model = on_meta(replace(config, frames=frames, text_layers=0))
    with torch.device("meta"):
        x, number = torch.empty(1, frames, config.features), torch.zeros(1, dtype=torch.long)
        text = condition_of(
            torch.empty(1, text_tokens, 512),
            torch.ones(1, text_tokens, dtype=torch.bool),
            past=PastSegment(x, number, number),
        )
        prepared = model.prepare(text)
        with FlopCounterMode(display=False) as counter:
            model(x, number, prepared)
    return counter.get_total_flops()


DERIVED = {196: 9.93e9, 28: 1.82e9}


@pytest.mark.parametrize("frames", DERIVED)
def test_operations_of_a_call_are_the_derived_ones(frames):
    # Counted by hand, two operations a multiplication: what every frame costs, every text token, every call.
    a_frame = 8 * (7 * 512**2 + 3 * 512 * 64 + 2 * 512 * 1024) + 2 * 251 * 512
    a_token = 8 * (2 * 256 * 512 + 512 * 64)
    a_call = 8 * 3 * 2048 * 1024 + 512 * 2048 + 2048**2
    counted = flops(KIT, frames)
    assert counted == 2 * (frames * a_frame + 77 * a_token + a_call)
    assert counted == pytest.approx(DERIVED[frames], rel=5e-3)  # printed with three digits


def test_reading_the_previous_segment_costs_a_quarter_more():
    assert 1.215 < flops(replace(KIT, prev="xattn", max_index=1), 28) / flops(KIT, 28) < 1.245


@pytest.mark.parametrize("features", [263, 251])
def test_paper_sized_shapes(features):
    config = SegmentDenoiserConfig(features=features, layers=1, prev="xattn", max_index=6)
    model, taps = on_meta(config), []
    with torch.device("meta"):
        x, number = torch.empty(2, 196, features), torch.zeros(2, dtype=torch.long)
        tokens, mask = torch.empty(2, 77, 512), torch.ones(2, 77, dtype=torch.bool)
        assert call(model, x, number, x[:, :28], number, number, tokens, mask, taps=taps).shape == x.shape
    assert [tuple(tap.shape) for tap in taps] == [(2, 196, 512)]


def naive(q, k, v, mask):
    """Efficient attention entry by entry: y_n = sum_d softmax_d(q_n)_d sum_m softmax_m(k_.d)_m v_m."""
    out = torch.zeros(*q.shape[:3], v.shape[-1], dtype=q.dtype)
    for b in range(q.shape[0]):
        read = [m for m in range(k.shape[1]) if mask[b, m]]
        for h in range(q.shape[2]):
            for n in range(q.shape[1]):
                total_q = sum(math.exp(entry) for entry in q[b, n, h].tolist())
                for d in range(q.shape[3]):
                    total_k = sum(math.exp(k[b, m, h, d]) for m in read)
                    for m in read:
                        weight = math.exp(q[b, n, h, d]) / total_q * math.exp(k[b, m, h, d]) / total_k
                        out[b, n, h] += weight * v[b, m, h]
    return out


def test_linear_attention_is_its_formula():
    g = torch.Generator().manual_seed(0)
    q, k, v = (torch.randn(2, length, 2, 3, dtype=torch.float64, generator=g) for length in (4, 5, 5))
    mask = torch.tensor([[True] * 5, [True, False, True, True, False]])
    torch.testing.assert_close(linear_attention(q, k, v, mask), naive(q, k, v, mask))
    torch.testing.assert_close(linear_attention(q, k, v, None), naive(q, k, v, torch.ones_like(mask)))
    nothing = linear_attention(q, k, v, torch.zeros_like(mask))
    assert torch.equal(nothing, torch.zeros_like(nothing))


def test_a_fresh_network_is_zero_and_its_layers_are_the_identity(inputs):
    model, taps = RECURRENT.build(), []
    assert call(model, *inputs, taps=taps).abs().max() == 0
    assert torch.equal(taps[0], taps[1])


def test_the_summary_is_the_last_real_token(inputs):
    *_, tokens, mask = inputs
    model = awake(TINY)
    states = model.prepare(condition_of(tokens, mask))
    for row, last in enumerate([6, 3, 0, 4]):
        torch.testing.assert_close(states.summary[row], model.text_summary(states.states[row, last]))


def test_the_last_frames_reach_the_network_twice(inputs):
    x, t, prev, *rest = inputs
    model = awake(RECURRENT)
    expected = call(model, x, t, prev, *rest)
    model.previous.boundary_in.weight.data.mul_(2)
    assert not torch.allclose(call(model, x, t, prev, *rest)[2:], expected[2:], atol=1e-4)
    one_frame = call(model, x, t, prev[:, -1:], *rest)  # less than the boundary
    assert one_frame.shape == x.shape


def test_segment_numbers_saturate(inputs):
    x, t, prev, prev_t, _, *text = inputs
    model = awake(RECURRENT)
    one, two, many = (call(model, x, t, prev, prev_t, torch.full((4,), i), *text) for i in (1, 2, 10**6))
    assert torch.equal(two, many)
    assert not torch.allclose(one, two, atol=1e-4)
    volume = awake(TINY)
    assert torch.equal(
        call(volume, x, t, prev, prev_t, torch.zeros(4).long(), *text),
        call(volume, x, t, 1 - prev, t, torch.ones(4).long(), *text),
    )


def test_lengths_that_do_not_fit_are_one_sentence(inputs):
    x, t, prev, *rest = inputs
    model = RECURRENT.build()
    with pytest.raises(InputError, match="segment of 16 frames exceeds"):
        call(model, torch.cat((x, x), dim=1), t, prev, *rest)
    with pytest.raises(InputError, match="previous segment of 16 frames exceeds"):
        call(model, x, t, torch.cat((prev, prev), dim=1), *rest)
