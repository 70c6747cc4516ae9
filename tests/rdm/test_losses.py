"""What the networks of RDM learn from, by closed forms."""

import math

import pytest
import torch

from moveset.models.flow import FlowConfig
from moveset.rdm.losses import flow_loss, jacobian_weight, masked_mse, velocity_loss
from moveset.rdm.transport import Transport


def _rand(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


MADE, REAL, LAST = _rand(3, 4, 5, seed=1), _rand(3, 4, 5, seed=2), _rand(3, 5, seed=3)
VALID = torch.arange(4) < torch.tensor([4, 2, 1])[:, None]


def test_squared_error_is_the_mean_over_valid_frames_of_all_rows():
    want = torch.stack([(MADE[row, k] - REAL[row, k]).square().mean() for row, k in VALID.nonzero().tolist()]).mean()
    torch.testing.assert_close(masked_mse(MADE, REAL, VALID), want)
    everything = torch.ones(3, 4, dtype=torch.bool)
    torch.testing.assert_close(masked_mse(MADE, REAL, everything), (MADE - REAL).square().mean())


def test_padding_does_not_count():
    wild = torch.where(VALID[..., None], MADE, 1e6)
    assert torch.equal(masked_mse(wild, REAL, VALID), masked_mse(MADE, REAL, VALID))
    rows = torch.tensor([True, False, True])
    assert torch.equal(velocity_loss(wild, REAL, LAST, rows, VALID), velocity_loss(MADE, REAL, LAST, rows, VALID))
    assert float(masked_mse(MADE, REAL, torch.zeros_like(VALID))) == 0


def test_velocity_is_of_differences_and_of_the_seam():
    by_hand = []
    has = torch.tensor([True, False, True])
    for row in range(3):
        for k in range(int(VALID[row].sum())):
            if k == 0 and not has[row]:
                continue
            made, real = (x[row, k] - (x[row, k - 1] if k else LAST[row]) for x in (MADE, REAL))
            by_hand.append((made - real).square().mean())
    torch.testing.assert_close(velocity_loss(MADE, REAL, LAST, has, VALID), torch.stack(by_hand).mean())


def test_an_offset_costs_velocity_only_where_it_begins():
    """A segment beside the truth by a constant 3 has the right differences, except for the step into it."""
    full = torch.ones(3, 4, dtype=torch.bool)
    none, every = torch.zeros(3, dtype=torch.bool), torch.ones(3, dtype=torch.bool)
    assert float(velocity_loss(REAL + 3, REAL, LAST, none, full)) == pytest.approx(0, abs=1e-10)
    assert float(velocity_loss(REAL + 3, REAL, LAST, every, full)) == pytest.approx(9 / 4, rel=1e-5)


@pytest.fixture
def flow():
    torch.manual_seed(0)
    return FlowConfig(features=5, blocks=2, hidden=8, text_dim=3, text_context=2, index_context=2).build()


def test_a_fresh_flow_is_judged_as_the_identity(flow):
    context, noise = flow.context(_rand(3, 3), torch.tensor([1, 2, 3])), 0.1 * _rand(3, 4, 5, seed=4)
    loss, error = flow_loss(flow, MADE, REAL, VALID, context, noise, isometry=7.0)
    torch.testing.assert_close(loss, masked_mse(MADE + noise, REAL, VALID))  # its log-scales are zero
    torch.testing.assert_close(error, loss.detach())
    assert not error.requires_grad
    plain, _ = flow_loss(flow, MADE, REAL, VALID, context)
    torch.testing.assert_close(plain, masked_mse(MADE, REAL, VALID))


def test_scales_away_from_one_cost_what_isometry_says(flow):
    for block in flow.blocks:
        block.out.reset_parameters()
    context = flow.context(_rand(3, 3), torch.tensor([1, 2, 3]))
    made, log_scales = flow.log_scales(MADE, context)
    assert log_scales.abs().max() > 1e-3
    loss, error = flow_loss(flow, MADE, REAL, VALID, context, None, isometry=7.0)
    torch.testing.assert_close(error, masked_mse(made, REAL, VALID).detach())
    torch.testing.assert_close(loss, error + 7.0 * log_scales.square().mean())
    loss.backward()
    assert all(parameter.grad is not None and parameter.grad.any() for parameter in flow.blocks.parameters())


def test_the_printed_weight_of_a_cell_is_one_over_the_scales_of_its_valid_frames(flow):
    """A flow whose log-scales are all .05 moves ten features a frame in two applications of two blocks."""
    index, pooled = torch.tensor([0, 1, 2]), _rand(3, 3)
    transport = Transport(flow, depth_cap=2)
    assert torch.equal(jacobian_weight(transport, REAL, VALID, index, pooled, 1.0), torch.ones(3))
    with torch.no_grad():
        for block in flow.blocks:
            block.out.bias.chunk(2)[0].fill_(0.1 * math.atanh(0.5))
    frames = VALID.sum(dim=1)
    for power in (1.0, 1 / 20):
        wanted = torch.exp(-power * 0.05 * 5 * frames * index)
        torch.testing.assert_close(jacobian_weight(transport, REAL, VALID, index, pooled, power), wanted)
