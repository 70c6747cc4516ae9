"""Samplers: what they evaluate and when, reproducibility, and diffusers as an oracle."""

from itertools import pairwise

import pytest
import torch

from moveset.diffusion.guidance import cfg
from moveset.diffusion.phases import PhaseGrid
from moveset.diffusion.schedule import scaled_linear
from moveset.diffusion.steps import ddim_step, ddim_timesteps, predict_z0
from moveset.errors import InputError
from moveset.pcm.consistency import lcm_scalings
from moveset.pcm.sampler import item_noise, lcm_timesteps, sample_ddim, sample_lcm, sample_phased

SCHEDULE = scaled_linear()


class Recorder:
    """A made-up denoiser that notes its calls."""

    def __init__(self):
        self.times, self.inputs = [], []

    def __call__(self, z, t):
        assert t.shape == (len(z),)
        assert (t == t[0]).all()
        self.times.append(int(t[0]))
        self.inputs.append(z)
        return torch.tanh(z * (1 + t[0] / 1000))

    def guided(self, z, t):
        eps = self(z, t)
        return cfg(eps, 0.9 * eps, 6.5)


@pytest.fixture
def noise():
    return item_noise([3, 1, 2], (16, 32))


def test_teacher_equals_diffusers(noise):
    diffusers = pytest.importorskip("diffusers")
    oracle = diffusers.DDIMScheduler(
        1000, 0.00085, 0.012, "scaled_linear", clip_sample=False, set_alpha_to_one=True, steps_offset=1
    )
    oracle.set_timesteps(50)
    model, z = Recorder(), noise
    for t in oracle.timesteps:
        cond = model(z, t.expand(3))
        z = oracle.step(0.9 * cond + 7.5 * (cond - 0.9 * cond), t, z).prev_sample
    ours = Recorder()
    result = sample_ddim(ours.guided, SCHEDULE, ddim_timesteps(50), noise)
    assert ours.times == model.times
    torch.testing.assert_close(result, z, atol=2e-3, rtol=2e-4)


@pytest.mark.parametrize(("phases", "times"), [(1, [999]), (2, [999, 499]), (4, [999, 699, 499, 199])])
def test_phased_evaluates_once_at_each_training_edge(phases, times, noise):
    model, grid = Recorder(), PhaseGrid(10, phases)
    result = sample_phased(model, SCHEDULE, grid, noise)
    assert model.times == times
    assert model.inputs[0] is noise
    for (z, after), (t, s) in zip(pairwise([*model.inputs, None]), grid.jumps, strict=True):
        t_B = torch.full((3,), t)
        eps = model(z, t_B)
        if after is None:  # the last jump ends at the noise-free estimate, not at z_0's noise level
            assert torch.equal(result, predict_z0(SCHEDULE, z, eps, t_B))
        else:
            assert torch.equal(after, ddim_step(SCHEDULE, z, eps, t_B, torch.full((3,), s)))
    assert torch.equal(result, sample_phased(Recorder(), SCHEDULE, grid, noise))


@pytest.mark.parametrize("count", [1, 2, 4, 10])
def test_lcm_equals_diffusers(count):
    diffusers = pytest.importorskip("diffusers")
    oracle = diffusers.LCMScheduler(
        1000, 0.00085, 0.012, "scaled_linear", original_inference_steps=10, timestep_scaling=10.0
    )
    oracle.set_timesteps(count, original_inference_steps=10)
    assert lcm_timesteps(count) == tuple(oracle.timesteps.tolist())
    noise = item_noise([4, 5], (count, 16, 32)).unbind(1)
    model, z = Recorder(), noise[0]
    generator = torch.Generator().manual_seed(9)
    drawn = [torch.randn(2, 16, 32, generator=generator) for _ in range(count - 1)]
    generator.manual_seed(9)
    for t in oracle.timesteps:
        z = oracle.step(model(z, t.expand(2)), t, z, generator=generator).prev_sample
    ours = sample_lcm(Recorder(), SCHEDULE, lcm_timesteps(count), [noise[0], *drawn])
    torch.testing.assert_close(ours, z, atol=1e-3, rtol=1e-4)


def test_the_boundary_condition_equals_diffusers():
    """From t = 99 on, where samplers evaluate, it shows no more; near 0, where targets are taken, it does."""
    diffusers = pytest.importorskip("diffusers")
    oracle = diffusers.LCMScheduler(1000, timestep_scaling=10.0)
    for t in (0, 1, 2, 10, 99, 999):
        expected = torch.tensor(oracle.get_scalings_for_boundary_condition_discrete(t), dtype=torch.float64)
        torch.testing.assert_close(torch.stack(lcm_scalings(torch.tensor(t), torch.float64)), expected)


def test_lcm_starts_where_it_is_told_and_wants_one_noise_a_time(noise):
    model = Recorder()
    sample_lcm(model, SCHEDULE, (799, 299), [noise, noise])
    assert model.times == [799, 299]
    for times in ((), (999, 499)):
        with pytest.raises(InputError):
            sample_lcm(model, SCHEDULE, times, [noise])


@pytest.mark.parametrize("count", [0, 11, -1])
def test_lcm_steps_beyond_the_training_grid_are_refused(count):
    with pytest.raises(InputError, match=str(count)):
        lcm_timesteps(count)


def test_item_noise_belongs_to_the_item():
    eight = item_noise(range(20, 28), (16, 32))
    assert eight.shape == (8, 16, 32)
    assert torch.equal(eight[3], item_noise([23], (16, 32))[0])
    assert torch.equal(item_noise([23], (4, 16, 32))[0, 0], eight[3])
    assert len({float(item.sum()) for item in eight}) == 8
    assert abs(eight.mean()) < 0.1
    assert abs(eight.std() - 1) < 0.05
