"""The selective scan against the recurrence it stands for, its gradients, and the block around it."""

import pytest
import torch
from torch.nn import functional as fn

from moveset.models.layers import sinusoids
from moveset.models.selective_scan import Mamba, recurrence, selective_scan


@pytest.fixture
def parts():
    g = torch.Generator().manual_seed(0)

    def draw(*shape):
        return torch.randn(*shape, dtype=torch.float64, generator=g)

    u, dt, into, outof = draw(2, 5, 3), fn.softplus(draw(2, 5, 3)), draw(2, 5, 4), draw(2, 5, 4)
    return u, dt, -fn.softplus(draw(3, 4)), into, outof, draw(3)


def naive(u, dt, rate, into, outof, skip):
    """Number by number, as the state space is defined."""
    out = torch.zeros_like(u)
    for b in range(u.shape[0]):
        for e in range(u.shape[2]):
            state = [0.0] * rate.shape[1]
            for step in range(u.shape[1]):
                size = dt[b, step, e]
                for n in range(rate.shape[1]):
                    state[n] = torch.exp(size * rate[e, n]) * state[n] + size * into[b, step, n] * u[b, step, e]
                    out[b, step, e] += outof[b, step, n] * state[n]
                out[b, step, e] += skip[e] * u[b, step, e]
    return out


def test_the_scan_is_the_recurrence_step_by_step(parts):
    torch.testing.assert_close(selective_scan(*parts), naive(*parts), rtol=1e-12, atol=1e-12)


def test_gradients_are_those_of_finite_differences(parts):
    parts = [part.requires_grad_() for part in parts]
    assert torch.autograd.gradcheck(selective_scan, parts)


@pytest.mark.parametrize("length", [1, 2, 7])
def test_the_recurrence_and_its_gradients(length):
    g = torch.Generator().manual_seed(length)
    a, b = (torch.randn(length, 3, dtype=torch.float64, generator=g).requires_grad_() for _ in range(2))
    assert torch.autograd.gradcheck(recurrence, (a, b))
    states = [b[0]]
    for step in range(1, length):
        states.append(a[step] * states[-1] + b[step])
    torch.testing.assert_close(recurrence(a, b), torch.stack(states))
    # From zero, the first factor multiplies nothing.
    (grad,) = torch.autograd.grad(recurrence(a, b).sum(), a)
    assert torch.equal(grad[0], torch.zeros(3).double())


def test_a_constant_input_settles_where_the_equation_says():
    # h' = A h + B u held at u: h = (1 - e^(A t)) / (-A) B u, but for the step of dt B instead of its exact integral.
    length, dt, rate = 400, 0.05, -0.7
    one = torch.ones(1, length, 1, dtype=torch.float64)
    y = selective_scan(one, dt * one, torch.tensor([[rate]]).double(), one, one, torch.zeros(1).double())
    decay = torch.exp(torch.tensor(dt * rate).double())
    expected = dt * (1 - decay ** torch.arange(1, length + 1)) / (1 - decay)
    torch.testing.assert_close(y[0, :, 0], expected)


def test_half_precision_is_computed_in_single(parts):
    half = [part.bfloat16() for part in parts]
    out = selective_scan(*half)
    assert out.dtype == torch.bfloat16
    torch.testing.assert_close(out, selective_scan(*(part.float() for part in half)).bfloat16())
    single = [part.float() for part in parts]
    with torch.autocast("cpu", dtype=torch.bfloat16):
        assert torch.equal(selective_scan(*single), selective_scan(*single))
        assert selective_scan(*single).dtype == torch.float32


@pytest.fixture(scope="module")
def mamba():
    torch.manual_seed(0)
    return Mamba(width=6, states=4, convolution=4, expand=2, rank=3).double()


def test_the_block_is_its_formula(mamba):
    x = torch.randn(2, 7, 6).double()
    inner, gate = (x @ mamba.inward.weight.T).split(12, dim=-1)
    kernel, mixed = mamba.convolution.weight[:, 0], torch.zeros_like(inner)
    for step in range(7):
        for back in range(min(4, step + 1)):
            mixed[:, step] += kernel[:, 3 - back] * inner[:, step - back]
    u = fn.silu(mixed + mamba.convolution.bias)
    low, into, outof = (u @ mamba.select.weight.T).split((3, 4, 4), dim=-1)
    dt = torch.log1p(torch.exp(low @ mamba.step.weight.T + mamba.step.bias))
    y = naive(u, dt, -mamba.log_rate.exp(), into, outof, mamba.skip) * gate * gate.sigmoid()
    torch.testing.assert_close(mamba(x, torch.ones(2, 7).bool()), y @ mamba.outward.weight.T)


def test_the_block_looks_back_only(mamba):
    x = torch.randn(1, 7, 6).double()
    everything = torch.ones(1, 7).bool()
    later = x.clone()
    later[:, 4:] += 1
    a, b = mamba(x, everything), mamba(later, everything)
    torch.testing.assert_close(a[:, :4], b[:, :4])
    assert not torch.allclose(a[:, 4], b[:, 4])


def test_masked_elements_are_no_elements(mamba):
    x = torch.randn(1, 5, 6).double()
    alone = mamba(x, torch.ones(1, 5).bool())
    padded = torch.cat((torch.full((1, 3, 6), float("nan")), x, torch.full((1, 2, 6), 9.0)), dim=1).double()
    mask = (torch.arange(10) >= 3) & (torch.arange(10) < 8)
    torch.testing.assert_close(mamba(padded, mask[None])[:, 3:8], alone)


def test_first_step_sizes_are_spread_as_published():
    torch.manual_seed(0)
    dt = fn.softplus(Mamba(width=64, states=16, convolution=4, expand=2, rank=4).step.bias)
    assert 0.001 <= dt.min() < 0.003 < 0.03 < dt.max() <= 0.1


def test_sinusoids_are_the_table():
    table = sinusoids(torch.arange(9), 6)
    for place in range(9):
        for i in range(3):
            angle = torch.tensor(place / 10000 ** (2 * i / 6))
            torch.testing.assert_close(table[place, 2 * i : 2 * i + 2], torch.stack((angle.sin(), angle.cos())))
    assert torch.equal(sinusoids(torch.arange(6).reshape(2, 3), 6)[1], table[3:6])
