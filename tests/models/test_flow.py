"""The coupling flow is a bijection: exactly inverted, causal, near-isometric, in float32, and the identity at first."""

import json

import pytest
import torch
import zuko
from torch import nn

from moveset.models.flow import CouplingFlow, FlowConfig
from moveset.models.packed import pack
from moveset.models.registry import build_model, describe
from moveset.text.packed_linear import can_pack

TINY = {"features": 5, "hidden": 8, "text_dim": 6, "text_context": 4, "index_context": 3}


def _rand(*shape, seed=0, dtype=torch.float32):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=dtype)


def moved(flow: CouplingFlow, gain: float = 1.0) -> CouplingFlow:
    """Away from the identity: the zero layers get the usual initial weights, times a gain."""
    torch.manual_seed(1)
    for block in flow.blocks:
        block.out.reset_parameters()
        with torch.no_grad():
            block.out.weight.mul_(gain)
    return flow


@pytest.fixture(scope="module")
def full():
    """The size of the paper, with random weights, and a batch of segments."""
    torch.manual_seed(0)
    flow = moved(FlowConfig().build()).eval()
    return flow, _rand(2, 28, 269), flow.context(_rand(2, 384, seed=1), torch.tensor([1, 2])).detach()


def tiny(dtype=torch.float32, gain=4.0, **changes):
    torch.manual_seed(0)
    flow = moved(FlowConfig(**TINY | changes).build().to(dtype), gain)
    context = flow.context(_rand(3, 6, seed=1, dtype=dtype), torch.tensor([0, 1, 2])).detach()
    return flow, _rand(3, 4, flow.config.features, dtype=dtype), context


def test_a_fresh_flow_is_the_identity():
    flow = FlowConfig().build()
    x, context = _rand(2, 28, 269), flow.context(_rand(2, 384), torch.tensor([0, 3]))
    y, log_scales = flow.log_scales(x, context)
    assert torch.equal(y, x)
    assert torch.equal(flow.inverse(x, context), x)
    assert log_scales.shape == (2, 28, 3 * 269)
    assert not log_scales.any()


@torch.no_grad()
def test_round_trip_in_single_precision_at_every_depth():
    torch.manual_seed(0)
    flow, x = moved(FlowConfig().build(), 8.0), _rand(2, 28, 269)
    context = flow.context(_rand(2, 384, seed=1), torch.tensor([1, 2]))
    assert (flow(x, context) - x).norm() > 0.1 * x.norm()
    carried = x
    for depth in range(1, 7):
        carried = flow(carried, context)
        back = carried
        for _ in range(depth):
            back = flow.inverse(back, context)
        assert (back - x).norm() < 1e-4 * x.norm(), depth
        assert (back - x).abs().max() < 1e-4 * x.abs().max(), depth


@pytest.mark.parametrize("blocks", [1, 2, 5])
@pytest.mark.parametrize("features", [2, 5, 8])
@pytest.mark.parametrize("bound", ["tanh", "hardtanh"])
def test_both_ways_are_inverse_whatever_the_size(blocks, features, bound):
    flow, x, context = tiny(torch.float64, blocks=blocks, features=features, bound=bound, log_scale=0.5)
    for there, back in ((flow, flow.inverse), (flow.inverse, flow)):
        carried = there(x, context)
        assert (carried - x).abs().max() > 0.05
        torch.testing.assert_close(back(carried, context), x, atol=1e-12, rtol=0)


@pytest.mark.parametrize("blocks", [1, 2, 3])
def test_the_sum_of_log_scales_is_the_log_determinant(blocks):
    flow, x, context = tiny(torch.float64, blocks=blocks, log_scale=0.5)
    y, log_scales = flow.log_scales(x, context)
    torch.testing.assert_close(y, flow(x, context), atol=0, rtol=0)
    for row in range(3):
        of_row = context[row : row + 1]
        jacobian = torch.autograd.functional.jacobian(
            lambda v, c=of_row: flow(v.view(1, 4, 5), c).flatten(), x[row].flatten()
        )
        sign, log_det = torch.linalg.slogdet(jacobian)
        assert sign == 1
        assert abs(log_det) > 1e-2
        torch.testing.assert_close(log_scales[row].sum(), log_det, atol=1e-10, rtol=1e-10)


@torch.no_grad()
@pytest.mark.parametrize("frames", [1, 5, 27])
def test_later_frames_and_padding_reach_no_earlier_frame(full, frames):
    flow, x, context = full
    other = x.clone()
    other[:, frames:] = 100 * _rand(2, 28 - frames, 269, seed=5)
    for way in (flow, flow.inverse):
        y, y_other = way(x, context), way(other, context)
        torch.testing.assert_close(y_other[:, :frames], y[:, :frames], atol=1e-5, rtol=0)
        torch.testing.assert_close(way(x[:, :frames], context), y[:, :frames], atol=1e-5, rtol=0)
        assert (y_other[:, frames:] - y[:, frames:]).abs().min(dim=-1).values.max() > 0


@torch.no_grad()
def test_the_past_matters(full):
    flow, x, context = full
    other = x.clone()
    other[:, 0] += 1
    for way in (flow, flow.inverse):
        assert (way(other, context) - way(x, context))[:, 1].abs().max() > 1e-4


@torch.no_grad()
def test_autocast_changes_nothing(full):
    flow, x, _ = full
    pooled, index = _rand(2, 384, seed=1), torch.tensor([1, 2])
    context = flow.context(pooled, index)
    y = flow(x, context)
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert (x[0] @ x[0].T).dtype == torch.bfloat16  # autocast is on
        cast = flow.context(pooled, index)
        assert torch.equal(cast, context)
        assert torch.equal(flow(x, cast), y)
        assert torch.equal(flow.inverse(y, cast), flow.inverse(y.float(), context))
        assert flow(x.bfloat16(), cast.bfloat16()).dtype == torch.float32


@pytest.mark.parametrize("bound", ["tanh", "hardtanh"])
def test_log_scales_stay_bounded(bound):
    flow, x, context = tiny(gain=1000.0, bound=bound, log_scale=0.1, blocks=6)
    _, log_scales = flow.log_scales(x, context)
    assert log_scales.abs().max() <= 0.1 + 1e-7
    assert log_scales.abs().max() > 0.0999


def test_only_tanh_keeps_a_gradient_near_the_bound():
    for bound, learns in (("tanh", True), ("hardtanh", False)):
        flow, x, context = tiny(gain=0.0, bound=bound, blocks=1)
        with torch.no_grad():
            flow.blocks[0].out.bias.fill_(0.15)  # beyond the bound of 0.1 for hardtanh
        _, log_scales = flow.log_scales(x, context)
        log_scales.sum().backward()
        assert bool(flow.blocks[0].out.bias.grad.any()) is learns


def test_gradients_reach_every_parameter():
    flow, x, _ = tiny(blocks=4)
    context = flow.context(_rand(3, 6, seed=1), torch.tensor([0, 1, 2]))
    flow(x, context).square().sum().backward()
    assert [name for name, p in flow.named_parameters() if p.grad is None or not p.grad.any()] == []


def test_every_feature_is_moved_in_two_blocks_and_pairs_differ():
    flow = FlowConfig(**TINY | {"features": 9, "blocks": 4}).build()
    parts = [(set(b.order[: b.passed].tolist()), set(b.order[b.passed :].tolist())) for b in flow.blocks]
    assert all(passed | active == set(range(9)) for passed, active in parts)
    assert parts[0] == parts[1][::-1]
    assert parts[2] == parts[3][::-1]
    assert parts[0] != parts[2]


def test_the_context_knows_sentence_and_index():
    flow = FlowConfig(**TINY | {"max_index": 2}).build()
    pooled = _rand(1, 6)
    of = [flow.context(pooled, torch.tensor([i])) for i in range(5)]
    assert of[0].shape == (1, 7)
    assert not torch.equal(of[0], of[1])
    assert not torch.equal(of[1], of[2])
    assert torch.equal(of[2], of[3])
    assert torch.equal(of[2], of[4])
    assert not torch.equal(of[0], flow.context(pooled + 1, torch.tensor([0])))


def _lstm(layer: nn.LSTM, x_BnI):
    """The recurrence, written out."""
    h = c = x_BnI.new_zeros(len(x_BnI), layer.hidden_size)
    states = []
    for x in x_BnI.unbind(1):
        gates = x @ layer.weight_ih_l0.T + layer.bias_ih_l0 + h @ layer.weight_hh_l0.T + layer.bias_hh_l0
        i, f, g, o = gates.chunk(4, dim=-1)
        c = f.sigmoid() * c + i.sigmoid() * g.tanh()
        h = o.sigmoid() * c.tanh()
        states.append(h)
    return torch.stack(states, 1)


def _zuko_coupling(block, context):
    """The same layer as a zuko coupling, which sorts the features of its two parts."""
    limit, passed, active = block.limit, block.order[: block.passed], block.order[block.passed :]
    mask = torch.zeros(len(block.order), dtype=torch.bool)
    mask[passed] = True
    rank, sort = passed.argsort().argsort(), active.argsort()

    def meta(x_a):
        h = _lstm(block.lstm, torch.cat((x_a[..., rank], context[:, None].expand(-1, x_a.shape[1], -1)), -1))
        h = h @ block.head[0].weight.T + block.head[0].bias
        raw, shift = (h * h.sigmoid() @ block.out.weight.T + block.out.bias).chunk(2, -1)
        log_scale = limit * torch.tanh(raw / limit)
        # zuko bounds its own way: log s = a / (1 + |a| / k), k = -log slope. Its inverse makes both say the same.
        k = 2.0
        a = log_scale / (1 - log_scale.abs() / k)
        slope = float(torch.exp(torch.tensor(-k, dtype=torch.float64)))
        affine = zuko.transforms.MonotonicAffineTransform(shift[..., sort], a[..., sort], slope=slope)
        return zuko.transforms.DependentTransform(affine, 1)

    return zuko.transforms.CouplingTransform(meta, mask)


@torch.no_grad()
@pytest.mark.parametrize("blocks", [1, 2, 5])
def test_zuko_composes_the_same_couplings(blocks):
    flow, x, context = tiny(torch.float64, blocks=blocks, log_scale=0.3, features=7)
    oracle = zuko.transforms.ComposedTransform(*(_zuko_coupling(block, context) for block in flow.blocks))
    y, log_scales = flow.log_scales(x, context)
    expected, log_det = oracle.call_and_ladj(x)  # zuko's sum is per frame: the last dimension is its event
    torch.testing.assert_close(y, expected, atol=1e-12, rtol=0)
    torch.testing.assert_close(log_scales.sum(-1), log_det, atol=1e-12, rtol=0)
    torch.testing.assert_close(flow.inverse(x, context), oracle.inv(x), atol=1e-12, rtol=0)
    assert (y - x).abs().max() > 0.1


def test_reconstruction_learns_a_transition_that_depends_on_text():
    torch.manual_seed(0)
    flow = FlowConfig(**TINY | {"hidden": 16}).build()
    pooled = torch.eye(6)[torch.arange(32) % 2]
    x = _rand(32, 6, 5)
    target = x + pooled[:, :1, None] * 0.7 - 0.3
    index = torch.ones(32, dtype=torch.long)
    optimizer = torch.optim.Adam(flow.parameters(), lr=5e-2)
    losses = []
    for _ in range(60):
        loss = (flow(x, flow.context(pooled, index)) - target).square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
    assert losses[-1] < 0.1 * losses[0]


def test_a_flow_comes_back_from_its_description_and_weights():
    flow, x, context = tiny(seed=7, bound="hardtanh")
    kind, config = describe(flow.config)
    assert kind == "coupling_flow"
    again = build_model(kind, json.loads(json.dumps(config)))
    assert again.config == flow.config
    assert all(torch.equal(a.order, b.order) for a, b in zip(again.blocks, flow.blocks, strict=True))
    again.load_state_dict(flow.state_dict())
    assert torch.equal(again(x, context), flow(x, context))
    other = build_model(kind, config | {"seed": 8})  # the permutations come with the weights
    assert any(not torch.equal(a.order, b.order) for a, b in zip(other.blocks, flow.blocks, strict=True))
    other.load_state_dict(flow.state_dict())
    assert torch.equal(other(x, context), flow(x, context))


@pytest.mark.skipif(not can_pack("cpu"), reason="this build of torch has no oneDNN")
@torch.no_grad()
def test_packed_weights_give_the_same():
    flow, x, _ = tiny()
    pooled, index = _rand(3, 6, seed=1), torch.tensor([0, 1, 2])
    plain = flow(x, flow.context(pooled, index))
    pack(flow)
    torch.testing.assert_close(flow(x, flow.context(pooled, index)), plain, atol=1e-5, rtol=1e-5)
