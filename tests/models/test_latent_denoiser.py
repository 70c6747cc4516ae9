"""What a denoiser whose input is carried to its output says."""

import pytest
import torch

from moveset.diffusion.schedule import scaled_linear
from moveset.diffusion.steps import add_noise
from moveset.models.latent_denoiser import LatentDenoiserConfig, carry
from tests.conditions import condition_of

SCHEDULE = scaled_linear()


@pytest.mark.parametrize("t", [0, 1, 499, 998, 999])
def test_the_noise_of_a_velocity_is_that_which_was_added(t):
    clean, noise, t_B = torch.randn(3, 2, 5), torch.randn(3, 2, 5), torch.full((3,), t)
    alpha, sigma = SCHEDULE.alpha(t_B)[:, None, None], SCHEDULE.sigma(t_B)[:, None, None]
    made = carry(alpha * noise - sigma * clean, add_noise(SCHEDULE, clean, noise, t_B), t_B, SCHEDULE)
    torch.testing.assert_close(made, noise, atol=1e-6, rtol=1e-5)


@pytest.mark.parametrize("carried", [True, False])
def test_before_training_the_clean_latent_is_guessed_from_the_noisy_one_alone_if_carried(carried):
    network = LatentDenoiserConfig(
        tokens=1, token_dim=64, text_dim=6, width=16, heads=2, hidden=32, blocks=2, carried=carried
    ).build()
    z, t = torch.randn(4, 1, 64), torch.tensor([0, 300, 900, 999])
    with torch.inference_mode():
        said = network(z, t, condition_of(torch.randn(4, 3, 6)))
    alpha, sigma = SCHEDULE.alpha(t)[:, None, None], SCHEDULE.sigma(t)[:, None, None]
    clean = (z - sigma * said) / alpha
    # The best linear guess for latents of variance one; else the noise itself, 14.6 times as large at t = 999.
    torch.testing.assert_close(clean, alpha * z if carried else z / alpha, atol=1e-4, rtol=1e-4)


def test_a_student_of_a_carried_teacher_is_carried_too():
    teacher = LatentDenoiserConfig(tokens=1, token_dim=64, text_dim=6, width=16, heads=2, blocks=2, carried=True)
    assert teacher.build().student().config.carried
