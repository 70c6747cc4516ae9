"""Networks that say noise in samplers that ask for the clean segment."""

import torch

from moveset.diffusion.schedule import linear
from moveset.diffusion.steps import add_noise
from moveset.rdm.prediction import clean_from_noise
from moveset.rdm.sampler import sample
from moveset.rdm.staircase import Staircase
from moveset.rdm.transport import Transport
from tests.samplers import settings

SCHEDULE = linear()


def test_the_true_noise_is_the_true_segment():
    clean, noise = torch.randn(2, 3, 4, 5, generator=torch.Generator().manual_seed(0))
    t = torch.tensor([1, 500, 900])
    made = clean_from_noise(SCHEDULE, lambda x, t, *told, mask: noise)(
        add_noise(SCHEDULE, clean, noise, t), t, "anything", mask=None
    )
    torch.testing.assert_close(made, clean, rtol=1e-3, atol=1e-3)


def test_sampling_is_the_same_whatever_the_network_says():
    """For Gaussian data of mean m and deviation d both optimal predictions are linear in x_t."""
    m, d = 0.7, 0.3

    def parts(x, t):
        alpha, sigma = (f(t)[:, None, None] for f in (SCHEDULE.alpha, SCHEDULE.sigma))
        return alpha, sigma, (x - alpha * m) / (alpha**2 * d**2 + sigma**2)

    def clean(x, t, *told):
        alpha, _, score = parts(x, t)
        return m + d**2 * alpha * score

    def noise(x, t, *told):
        _, sigma, score = parts(x, t)
        return sigma * score

    made = [
        sample(denoiser, Transport(None), settings(Staircase(50, 1, start=0)), seeds=range(200), shape=(4, 5))
        for denoiser in (clean, clean_from_noise(SCHEDULE, noise))
    ]
    torch.testing.assert_close(made[0], made[1], rtol=1e-2, atol=1e-2)
    assert abs(float(made[1].mean()) - m) < 0.05
    assert abs(float(made[1].std()) - d) < 0.05
