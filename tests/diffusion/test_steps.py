"""Steps against diffusers' schedulers, and their broadcasting."""

from itertools import pairwise

import pytest
import torch

from moveset.diffusion.guidance import cfg, guidance_embedding
from moveset.diffusion.schedule import linear, scaled_linear
from moveset.diffusion.steps import (
    add_noise,
    ddim_step,
    ddim_timesteps,
    denoise_step,
    predict_eps,
    predict_z0,
    renoise,
)
from moveset.errors import InputError

SCHEDULE = scaled_linear()


@pytest.fixture
def generator():
    return torch.Generator().manual_seed(11)


@pytest.mark.parametrize("count", [2, 4, 10, 25, 50, 500])
def test_ddim_loop_equals_diffusers(count, generator):
    diffusers = pytest.importorskip("diffusers")
    oracle = diffusers.DDIMScheduler(
        1000, 0.00085, 0.012, "scaled_linear", clip_sample=False, set_alpha_to_one=False, steps_offset=1
    )
    oracle.set_timesteps(count)
    times = ddim_timesteps(count)
    assert list(times) == oracle.timesteps.tolist()
    ours = theirs = torch.randn(3, 16, 32, generator=generator)
    for t in times:
        eps = torch.tanh(ours) + 0.1 * torch.randn(3, 16, 32, generator=generator)
        s = max(t - 1000 // count, 0)  # diffusers: times before the start have alpha_bar_0
        ours = ddim_step(SCHEDULE, ours, eps, torch.tensor(t), torch.tensor(s))
        theirs = oracle.step(eps, t, theirs).prev_sample
        torch.testing.assert_close(ours, theirs, atol=2e-4, rtol=2e-5)


def test_noising_equals_diffusers(generator):
    diffusers = pytest.importorskip("diffusers")
    oracle = diffusers.DDIMScheduler(1000, 0.00085, 0.012, "scaled_linear")
    z0, eps = torch.randn(2, 4, 16, 32, generator=generator)
    t = torch.tensor([0, 99, 500, 999])
    z = add_noise(SCHEDULE, z0, eps, t)
    torch.testing.assert_close(z, oracle.add_noise(z0, eps, t), atol=2e-5, rtol=1e-5)
    torch.testing.assert_close(predict_z0(SCHEDULE, z, eps, t), z0, atol=1e-5, rtol=1e-5)


def test_renoising_keeps_the_marginal(generator):
    z0, first, second = torch.randn(3, 60_000, generator=generator)
    s, later = torch.tensor(199), torch.tensor(699)
    z = renoise(SCHEDULE, add_noise(SCHEDULE, 2 + 0 * z0, first, s), s, later, second)
    assert abs(z.mean() - 2 * SCHEDULE.alpha(later)) < 0.02
    assert abs(z.std() - SCHEDULE.sigma(later)) < 0.02
    assert torch.equal(renoise(SCHEDULE, z0, s, s, first), z0)


def test_one_level_per_segment(generator):
    z, eps = torch.randn(2, 2, 3, 16, 32, generator=generator)
    t = torch.tensor([[999, 499, 99], [0, 1, 2]])
    s = t // 2
    together = ddim_step(SCHEDULE, z, eps, t, s)
    for b in range(2):
        for n in range(3):
            torch.testing.assert_close(together[b, n], ddim_step(SCHEDULE, z[b, n], eps[b, n], t[b, n], s[b, n]))


@pytest.mark.parametrize("count", [-1, 0, 1, 501, 1000])
def test_absurd_step_counts_are_refused(count):
    with pytest.raises(InputError, match=str(count)):
        ddim_timesteps(count)


def test_guidance():
    c, u = torch.tensor([[1.0, 2.0], [3.0, 4.0]]), torch.tensor([[0.0, 1.0], [5.0, 4.0]])
    assert torch.equal(cfg(c, u, 0.0), c)
    torch.testing.assert_close(cfg(c, u, torch.tensor([1.0, 2.0])), torch.tensor([[2.0, 3.0], [-1.0, 4.0]]))
    # the printed scale s of Stable Diffusion is w + 1
    torch.testing.assert_close(cfg(c, u, 6.5), u + 7.5 * (c - u))


def test_guidance_embedding_equals_diffusers():
    pipeline = pytest.importorskip("diffusers").LatentConsistencyModelPipeline
    w = torch.tensor([0.0, 5.0, 7.25, 15.0])
    oracle = pipeline.get_guidance_scale_embedding(None, w, embedding_dim=256)
    # arguments reach 15000 radians, where float32 itself is only good to 1e-3
    torch.testing.assert_close(guidance_embedding(w), oracle, atol=2e-3, rtol=0)


def test_a_full_step_down_is_the_posterior_of_ddpm():
    """Ho et al. 2020, Eq. 7: the mean and the variance of q(x_{t-1} | x_t, x_0)."""
    schedule = linear()
    t = torch.tensor([2, 37, 500, 1000])
    a = schedule.alpha_bar
    beta = 1 - a[t] / a[t - 1]
    z, z0 = torch.randn(2, 4, 3, dtype=torch.float64)
    mean = (a[t - 1].sqrt() * beta / (1 - a[t]))[:, None] * z0
    mean = mean + ((1 - beta).sqrt() * (1 - a[t - 1]) / (1 - a[t]))[:, None] * z
    deviation = (beta * (1 - a[t - 1]) / (1 - a[t])).sqrt()[:, None]
    still = denoise_step(schedule, z, z0, t, t - 1, 1.0, torch.zeros_like(z))
    torch.testing.assert_close(still, mean)
    torch.testing.assert_close(denoise_step(schedule, z, z0, t, t - 1, 1.0, torch.ones_like(z)), mean + deviation)
    larger = denoise_step(schedule, z, z0, t, t - 1, 1.0, torch.ones_like(z), "beta")
    torch.testing.assert_close(larger, mean + beta.sqrt()[:, None])


@pytest.mark.parametrize("eta", [0.0, 0.5, 1.0])
def test_a_step_keeps_the_marginal(eta):
    """Whatever eta: from q(z_t | z_0) to q(z_s | z_0)."""
    schedule = linear()
    generator = torch.Generator().manual_seed(0)
    z0 = torch.full((200_000,), 0.7)
    eps, noise = torch.randn(2, len(z0), generator=generator)
    t, s = torch.tensor(800), torch.tensor(300)
    out = denoise_step(schedule, add_noise(schedule, z0, eps, t), z0, t, s, eta, noise)
    assert abs(out.mean() - 0.7 * schedule.alpha(s)) < 0.01
    assert abs(out.std() - schedule.sigma(s)) < 0.01


def test_the_clean_end_is_the_prediction_itself():
    schedule = linear()
    z, z0, noise = torch.randn(3, 2, 5)
    out = denoise_step(schedule, z, z0, torch.tensor([100, 7]), torch.tensor([0, 3]), 1.0, noise)
    assert torch.equal(out[0], z0[0])
    assert not torch.equal(out[1], z0[1])


@pytest.mark.parametrize(("count", "t"), [(1000, 999), (1000, 36), (50, 980)])
def test_the_larger_variance_is_that_of_diffusers(count, t, generator):
    diffusers = pytest.importorskip("diffusers")
    z, z0 = torch.randn(2, 3, 4, generator=generator)
    oracle = diffusers.DDPMScheduler(1000, variance_type="fixed_large", prediction_type="sample", clip_sample=False)
    oracle.set_timesteps(count)
    theirs = oracle.step(z0, t, z, generator=torch.Generator().manual_seed(1)).prev_sample
    noise, to = torch.randn(3, 4, generator=torch.Generator().manual_seed(1)), t + 1 - 1000 // count
    ours = denoise_step(linear(), z, z0, torch.tensor(t + 1), torch.tensor(to), 1.0, noise, "beta")
    torch.testing.assert_close(ours, theirs, atol=1e-4, rtol=1e-4)


def test_deterministic_step_equals_the_one_by_noise():
    schedule = linear()
    z, z0 = torch.randn(2, 4, 6)
    t, s = torch.tensor([1000, 500, 40, 2]), torch.tensor([999, 100, 20, 1])
    by_noise = ddim_step(schedule, z, predict_eps(schedule, z, z0, t), t, s)
    torch.testing.assert_close(denoise_step(schedule, z, z0, t, s), by_noise, atol=2e-5, rtol=1e-4)


def test_scaled_noise_gives_back_variety_that_a_timid_network_averages_away():
    """Data N(0, 1), and a denoiser that says .98 of what is to be expected."""
    schedule, deviation = linear(), {}
    for scale in (1.0, 1.03):
        z = torch.randn(4000, 1, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
        for t, s in pairwise(torch.linspace(1000, 0, 11).long()):
            z0 = 0.98 * schedule.alpha(t, z.dtype) * z
            stepped = denoise_step(schedule, z, z0, t.expand(4000), s.expand(4000), eps_scale=scale)
            eps = (z - schedule.alpha(t, z.dtype) * z0) / schedule.sigma(t, z.dtype)
            wanted = schedule.alpha(s, z.dtype) * z0 + scale * schedule.sigma(s, z.dtype) * eps if s else z0
            torch.testing.assert_close(stepped, wanted)
            z = stepped
        deviation[scale] = float(z.std())
    assert deviation[1.0] < 0.92
    assert abs(deviation[1.03] - 1) < 0.05


def test_an_unknown_variance_is_refused():
    with pytest.raises(InputError, match="variance 'learned' is not one of posterior, beta"):
        denoise_step(linear(), torch.zeros(1), torch.zeros(1), torch.tensor(5), torch.tensor(4), variance="learned")


@pytest.mark.parametrize(("eta", "noise"), [(0.3, None), (1.5, torch.zeros(1)), (-0.1, torch.zeros(1))])
def test_eta_out_of_range_or_without_noise_is_refused(eta, noise):
    with pytest.raises(InputError, match="eta"):
        denoise_step(linear(), torch.zeros(1), torch.zeros(1), torch.tensor([5]), torch.tensor([4]), eta, noise)
