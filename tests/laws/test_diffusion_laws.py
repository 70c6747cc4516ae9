"""Laws of steps on the noise schedule, checked in double precision, and Gaussian data whose noise is known exactly.

For data z_0 ~ N(mu, v) the marginal at t is N(alpha mu, alpha² v + sigma²), the best noise prediction is
sigma (z - alpha mu) / (alpha² v + sigma²), and the probability flow maps quantiles to quantiles.
"""

from itertools import pairwise

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from moveset.diffusion.guidance import cfg
from moveset.diffusion.schedule import scaled_linear
from moveset.diffusion.steps import add_noise, ddim_step, predict_z0

SCHEDULE = scaled_linear()
MU, V = torch.tensor([1.5, -0.5, 0.0, 3.0]).double(), torch.tensor([0.3, 2.0, 0.05, 1.0]).double()
times = st.integers(0, 999).map(torch.tensor)


def normal(*shape, seed=0, dtype=torch.float64):
    return torch.randn(*shape, dtype=dtype, generator=torch.Generator().manual_seed(seed))


def exact_eps(z, t, mu=MU):
    a, s = SCHEDULE.alpha(t, z.dtype), SCHEDULE.sigma(t, z.dtype)
    return s * (z - a * mu) / (a * a * V + s * s)


def exact_flow(z, t, s, mu=MU):
    at, st_, as_, ss = (f(x, z.dtype) for x in (t, s) for f in (SCHEDULE.alpha, SCHEDULE.sigma))
    return as_ * mu + ((as_**2 * V + ss**2) / (at**2 * V + st_**2)).sqrt() * (z - at * mu)


@given(times, times)
def test_step_is_the_papers_solution_operator(t, s):
    z, eps = normal(2, 5, 4)
    lam_t, lam_s = SCHEDULE.half_log_snr(t, z.dtype), SCHEDULE.half_log_snr(s, z.dtype)
    alpha_t, alpha_s = SCHEDULE.alpha(t, z.dtype), SCHEDULE.alpha(s, z.dtype)
    paper = alpha_s / alpha_t * z - alpha_s * eps * (torch.exp(-lam_t) - torch.exp(-lam_s))
    ddim = add_noise(SCHEDULE, predict_z0(SCHEDULE, z, eps, t), eps, s)
    ours = ddim_step(SCHEDULE, z, eps, t, s)
    torch.testing.assert_close(ours, paper, atol=1e-12, rtol=1e-12)
    torch.testing.assert_close(ours, ddim, atol=1e-12, rtol=1e-12)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_step_of_no_length_is_the_identity_to_the_last_bit(dtype):
    z, eps = normal(2, 1000, 7, dtype=dtype)
    t = torch.arange(1000)
    assert torch.equal(ddim_step(SCHEDULE, z, 100 * eps, t, t), z)


@given(times, times, times)
def test_steps_with_the_same_noise_compose(t, s, r):
    z, eps = normal(2, 5, 4)
    direct = ddim_step(SCHEDULE, z, eps, t, r)
    torch.testing.assert_close(ddim_step(SCHEDULE, ddim_step(SCHEDULE, z, eps, t, s), eps, s, r), direct)


def test_sensitivity_to_the_prediction():
    one, zero = torch.ones(1).double(), torch.zeros(1).double()
    jumps = {(999, 0): -14.6, (999, 499): -6.85, (499, 0): -1.58}
    for (t, s), expected in jumps.items():
        assert float(ddim_step(SCHEDULE, zero, one, torch.tensor(t), torch.tensor(s))) == pytest.approx(
            expected, rel=2e-3
        )


@given(times, times, times)
def test_the_exact_flow_composes_and_inverts(t, s, r):
    z = normal(6, 4)
    torch.testing.assert_close(exact_flow(exact_flow(z, t, s), s, r), exact_flow(z, t, r))
    torch.testing.assert_close(exact_flow(exact_flow(z, t, s), s, t), z)


def test_many_small_steps_follow_the_exact_flow_with_first_order_error():
    z = normal(64, 4)
    errors = []
    for skip in (40, 20, 10, 5):
        grid = range(999, -1, -skip)
        x = z
        for t, s in zip(grid, [*grid[1:], 0], strict=True):
            t, s = torch.tensor(t), torch.tensor(s)
            x = ddim_step(SCHEDULE, x, exact_eps(x, t), t, s)
        exact = exact_flow(z, torch.tensor(999), torch.tensor(0))
        errors.append(float((x - exact).abs().mean()))
    ratios = [a / b for a, b in pairwise(errors)]
    assert errors[-1] < 0.01
    assert all(1.7 < ratio < 2.4 for ratio in ratios), (errors, ratios)


def test_guiding_between_gaussians_is_the_exact_noise_of_the_extrapolated_gaussian():
    z, t, w = normal(3, 4), torch.tensor(400), torch.tensor([0.0, 2.5, 15.0]).double()
    other = MU - torch.tensor([0.4, 0.0, -0.3, 1.0])
    guided = cfg(exact_eps(z, t), exact_eps(z, t, other), w)
    expected = torch.cat([exact_eps(z[k : k + 1], t, MU + w[k] * (MU - other)) for k in range(3)])
    torch.testing.assert_close(guided, expected)
