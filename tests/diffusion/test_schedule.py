"""The schedule against published values and against diffusers."""

import pytest
import torch

from moveset.diffusion.schedule import Schedule, cosine, linear, scaled_linear
from moveset.errors import InputError


def test_equal_to_diffusers():
    diffusers = pytest.importorskip("diffusers")
    oracle = diffusers.DDIMScheduler(1000, 0.00085, 0.012, "scaled_linear").alphas_cumprod
    torch.testing.assert_close(scaled_linear().alpha_bar.float(), oracle, atol=2e-7, rtol=2e-5)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_variance_is_preserved_and_shapes_follow_time(dtype):
    schedule = scaled_linear()
    t = torch.arange(1000).reshape(4, 250)
    alpha, sigma = schedule.alpha(t, dtype), schedule.sigma(t, dtype)
    assert alpha.shape == t.shape
    assert alpha.dtype == dtype
    tight = 1e-15 if dtype == torch.float64 else 2e-7
    torch.testing.assert_close(alpha**2 + sigma**2, torch.ones_like(alpha), atol=tight, rtol=0)
    assert (schedule.half_log_snr(torch.arange(1000), dtype).diff() < 0).all()


@pytest.mark.parametrize("t", [torch.tensor([500]), torch.tensor(500)], ids=["vector", "scalar"])
def test_tables_first_used_while_sampling_still_serve_training(t):
    schedule = scaled_linear()
    with torch.inference_mode():
        schedule.alpha(t)
    weight = torch.ones(1, requires_grad=True)
    (weight * schedule.alpha(t)).sum().backward()
    assert weight.grad == schedule.alpha(t)


@pytest.mark.parametrize("values", [[], [0.5, 0.5], [0.2, 0.8], [1.5, 0.5], [0.5, 0.0], [0.5, float("nan")]])
def test_impossible_schedules_are_refused(values):
    with pytest.raises(InputError):
        Schedule(torch.tensor(values, dtype=torch.float64))


def test_linear_starts_clean_and_is_that_of_ddpm():
    schedule = linear()
    assert len(schedule) == 1001
    t = torch.arange(1001)
    assert schedule.sigma(t)[0] == 0
    beta = 1 - schedule.alpha_bar[1:] / schedule.alpha_bar[:-1]
    torch.testing.assert_close(beta, 1e-4 + (t[1:].double() - 1) / 999 * (0.02 - 1e-4), atol=1e-12, rtol=0)


def test_cosine_is_that_of_diffusers():
    diffusers = pytest.importorskip("diffusers")
    oracle = diffusers.DDPMScheduler(10, beta_schedule="squaredcos_cap_v2").alphas_cumprod
    torch.testing.assert_close(cosine(10).alpha_bar[1:].float(), oracle, atol=1e-6, rtol=1e-4)
