"""Powers of the flow by segment number: capped, exactly undone, each row for itself."""

import pytest
import torch

from moveset.errors import InputError
from moveset.models.flow import FlowConfig
from moveset.rdm.transport import Transport


def _rand(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


def _moving(**sizes):
    """A flow that is not the identity."""
    torch.manual_seed(0)
    flow = FlowConfig(**sizes).build().eval().requires_grad_(False)
    for block in flow.blocks:
        block.out.reset_parameters()
    return flow


@pytest.fixture(scope="module")
def flow():
    return _moving(features=9, blocks=4, hidden=16, text_dim=6, text_context=4, index_context=3, max_index=4)


POOLED = _rand(5, 6, seed=1)
SEGMENTS = _rand(5, 4, 9, seed=2)
NUMBERS = torch.tensor([3, 0, 1, 7, 0])


def _power(flow, x, depth, context):
    for _ in range(depth):
        x = flow(x, context)
    return x


def test_depth_is_the_number_up_to_the_cap(flow):
    assert Transport(flow, 3).depth(torch.tensor([0, 1, 2, 3, 4, 100])).tolist() == [0, 1, 2, 3, 3, 3]
    assert Transport(flow).depth(torch.tensor([0, 1, 100])).tolist() == [0, 1, 1]


@pytest.mark.parametrize("cap", [1, 2, 4])
def test_push_is_the_power_of_each_row_under_its_own_context(flow, cap):
    y = SEGMENTS.clone()
    x = Transport(flow, cap).push(y, NUMBERS, POOLED)
    assert torch.equal(y, SEGMENTS)  # nothing is changed in place
    for row, number in enumerate(NUMBERS.tolist()):
        one = slice(row, row + 1)
        expected = _power(flow, y[one], min(number, cap), flow.context(POOLED[one], NUMBERS[one]))
        torch.testing.assert_close(x[one], expected, atol=1e-5, rtol=0)
    if cap > 1:
        assert (x[3] - Transport(flow, 1).push(y, NUMBERS, POOLED)[3]).abs().max() > 1e-2


@pytest.mark.parametrize("cap", [1, 3])
def test_log_det_is_that_of_the_whole_carrying_of_the_first_frames(cap):
    flow = _moving(features=3, blocks=2, hidden=8, text_dim=6, text_context=4, index_context=3, max_index=4).double()
    transport, y = Transport(flow, cap), SEGMENTS[..., :3].double()
    found = transport.log_det(y, NUMBERS, POOLED)
    assert found.shape == (5, 4)
    assert not found[NUMBERS == 0].any()
    assert not Transport(None).log_det(y, NUMBERS, POOLED).any()
    for row, frames in ((0, 4), (2, 4), (3, 2)):
        one = slice(row, row + 1)

        def push(z, one=one):
            return transport.push(z.view(1, -1, 3), NUMBERS[one], POOLED[one]).flatten()

        _, expected = torch.linalg.slogdet(torch.autograd.functional.jacobian(push, y[row, :frames].flatten()))
        assert abs(expected) > 1e-2
        torch.testing.assert_close(found[row, :frames].sum(), expected)


@pytest.mark.parametrize("cap", [1, 6])
def test_first_segments_are_left_alone(flow, cap):
    transport = Transport(flow, cap)
    for carry in (transport.push, transport.pull):
        x = carry(SEGMENTS, NUMBERS, POOLED)
        assert torch.equal(x[NUMBERS == 0], SEGMENTS[NUMBERS == 0])
        assert ((x - SEGMENTS)[NUMBERS > 0].abs().amax(dim=(1, 2)) > 1e-2).all()
        assert torch.equal(carry(SEGMENTS, torch.zeros(5, dtype=torch.long), POOLED), SEGMENTS)


@pytest.mark.parametrize("way", ["push", "pull"])
@pytest.mark.parametrize("cap", [1, 3])
def test_rows_do_not_depend_on_each_other(flow, way, cap):
    carry = getattr(Transport(flow, cap), way)
    together = carry(SEGMENTS, NUMBERS, POOLED)
    alone = torch.cat([carry(SEGMENTS[r : r + 1], NUMBERS[r : r + 1], POOLED[r : r + 1]) for r in range(5)])
    torch.testing.assert_close(together, alone, atol=1e-5, rtol=0)
    shuffled = torch.tensor([4, 2, 0, 1, 3])
    torch.testing.assert_close(
        carry(SEGMENTS[shuffled], NUMBERS[shuffled], POOLED[shuffled]), together[shuffled], atol=1e-5, rtol=0
    )


@pytest.mark.parametrize("cap", [1, 6])
def test_pull_undoes_push_at_the_size_of_the_paper(cap):
    transport = Transport(_moving(), cap)
    numbers, pooled, y = torch.arange(7), _rand(7, 384), _rand(7, 28, 269, seed=3)
    for there, back in ((transport.push, transport.pull), (transport.pull, transport.push)):
        carried = there(y, numbers, pooled)
        assert ((carried - y)[1:].flatten(1).norm(dim=1) > 0.05 * y[1:].flatten(1).norm(dim=1)).all()
        error = (back(carried, numbers, pooled) - y).flatten(1)
        assert (error.norm(dim=1) < 1e-4 * y.flatten(1).norm(dim=1)).all()


def test_without_a_flow_nothing_moves():
    transport = Transport(None, 3)
    assert torch.equal(transport.push(SEGMENTS, NUMBERS, POOLED), SEGMENTS)
    assert torch.equal(transport.pull(SEGMENTS, NUMBERS, POOLED), SEGMENTS)


@pytest.mark.parametrize("cap", [1, 3])
def test_gradients_reach_every_row(flow, cap):
    y = SEGMENTS.clone().requires_grad_()
    x = Transport(flow, cap).push(y, NUMBERS, POOLED)
    x.sum().backward()
    ones = torch.ones_like(y)
    assert torch.equal(y.grad[NUMBERS == 0], ones[NUMBERS == 0])
    assert (y.grad[NUMBERS > 0] != ones[NUMBERS > 0]).any(dim=2).any(dim=1).all()


@pytest.mark.parametrize("cap", [0, -1, 65])
def test_senseless_caps_are_refused(flow, cap):
    with pytest.raises(InputError, match="depth_cap"):
        Transport(flow, cap)
