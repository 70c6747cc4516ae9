"""The rollouts of the baselines: what is conditioned on what, how often the network is asked, and RDM as an oracle."""

from itertools import islice

import pytest
import torch

from moveset.diffusion.schedule import cosine, linear
from moveset.errors import InputError
from moveset.rdm.autoregressive import idle_prefix, rollout_chunks, rollout_segments
from moveset.rdm.sampler import sample
from moveset.rdm.staircase import Staircase, levels
from moveset.rdm.transport import Transport

SCHEDULE, SEEDS, SHAPE = linear(), (1, 2), (3, 4)


class Denoiser:
    """A made-up network that keeps what it is asked."""

    def __init__(self):
        self.asked = []

    def __call__(self, x, t, prev, prev_t, index, numbers):
        self.asked.append((int(t[0]), prev, prev_t.tolist(), index.tolist(), list(numbers)))
        return 0.5 * x + 0.3 * torch.tanh(prev) + t[:, None, None] / 3000


@pytest.mark.parametrize("eta", [0.0, 1.0])
def test_a_rollout_is_the_staircase_that_waits_for_finished_segments(eta):
    plan = Staircase(5, 4, 5, lag=5)
    oracle = sample(Denoiser(), Transport(None), SCHEDULE, levels(5), plan, SEEDS, SHAPE, eta=eta)
    net = Denoiser()
    made = list(islice(rollout_segments(net, SCHEDULE, levels(5), SEEDS, SHAPE, eta=eta), 4))
    assert torch.equal(torch.stack(made, dim=1), oracle)
    assert len(net.asked) == 5 * 4 == plan.calls == plan.waves
    for k, (t, prev, prev_t, index, numbers) in enumerate(net.asked):
        assert (t, prev_t, index, numbers) == (levels(5)[k % 5], [0, 0], [k // 5] * 2, [k // 5] * 2)
        if k >= 5:
            assert torch.equal(prev, made[k // 5 - 1])


def test_without_a_condition_every_segment_is_a_first_one():
    net = Denoiser()
    made = list(islice(rollout_segments(net, SCHEDULE, levels(4), SEEDS, SHAPE, condition="none"), 3))
    assert all(index == [0, 0] and not prev.any() for _, prev, _, index, _ in net.asked)
    assert [numbers[0] for *_, numbers in net.asked] == [0] * 4 + [1] * 4 + [
        2
    ] * 4  # each has its own text all the same
    assert not torch.allclose(made[0], made[1])
    first = next(rollout_segments(Denoiser(), SCHEDULE, levels(4), SEEDS, SHAPE))
    assert torch.equal(made[0], first)
    with pytest.raises(InputError, match="noisy_prev"):
        rollout_segments(net, SCHEDULE, levels(4), SEEDS, SHAPE, condition="noisy_prev")


@pytest.mark.parametrize(("frames", "chunks"), [(196, 5), (200, 5), (40, 1), (1, 1)])
def test_chunks_follow_the_last_frames(frames, chunks):
    asked, schedule = [], cosine(10)

    def denoise(x, t, prefix, number):
        assert x.shape == (2, 40, 4)
        asked.append((number, int(t[0]), prefix))
        return 0.1 * x + prefix[:, -1:] + 0.01 * torch.arange(40)[:, None]

    prefix = idle_prefix(torch.tensor([1.0, 2.0, 3.0, 4.0]), 2)
    assert prefix.shape == (2, 20, 4)
    assert torch.equal(prefix[1, 7], prefix[0, 0])
    made = rollout_chunks(denoise, schedule, prefix, frames, SEEDS)
    assert made.shape == (2, frames, 4)
    assert [(number, t) for number, t, _ in asked] == [(c, t) for c in range(chunks) for t in range(10, 0, -1)]
    for number, _, seen in asked:
        assert torch.equal(seen, prefix if number == 0 else made[:, 40 * number - 20 : 40 * number])
    longer = rollout_chunks(denoise, schedule, prefix, frames + 40, SEEDS)
    assert torch.equal(longer[:, :frames], made)


def test_a_prefix_longer_than_a_chunk_keeps_its_newest_frames():
    seen = []

    def denoise(x, t, prefix, number):
        seen.append(prefix)
        return torch.full_like(x, number + 1.0)

    rollout_chunks(denoise, cosine(4), torch.zeros(2, 5, 1), 6, SEEDS, chunk=2)
    assert [prefix[0, :, 0].tolist() for prefix in seen[::4]] == [[0, 0, 0, 0, 0], [0, 0, 0, 1, 1], [0, 1, 1, 2, 2]]


def test_ddpm_of_a_chunk_reproduces_the_law_of_its_data():
    """With the exact denoiser of N(prefix mean, 0.5²) the ten steps end near that law, whatever the prefix."""
    schedule = cosine(10)
    seeds = tuple(range(400))
    prefix = torch.linspace(-1, 1, 400)[:, None, None].expand(400, 3, 1)

    def posterior(x, t, before, number):
        alpha, sigma = schedule.alpha(t)[:, None, None], schedule.sigma(t)[:, None, None]
        mean, gain = before.mean(dim=1, keepdim=True), 0.25 * alpha / (0.25 * alpha**2 + sigma**2)
        return mean + gain * (x - alpha * mean)

    off = rollout_chunks(posterior, schedule, prefix, 8, seeds, chunk=8) - prefix[:, :1]
    assert abs(float(off.mean())) < 0.05
    assert 0.3 < float(off.std()) < 0.55  # ten steps of the smaller variance lose some of it


def test_rollouts_that_cannot_be_are_refused():
    for frames, prefix in ((0, torch.zeros(2, 3, 1)), (5, torch.zeros(3, 3, 1))):
        with pytest.raises(InputError, match="one prefix per seed"):
            rollout_chunks(lambda x, *_: x, cosine(4), prefix, frames, SEEDS)
