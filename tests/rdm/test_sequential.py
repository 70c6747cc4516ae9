"""Segments and chunks one after the other: what each is told, with the staircase as an oracle."""

import pytest
import torch

from moveset.diffusion.schedule import cosine, linear
from moveset.errors import InputError
from moveset.rdm.sequential import Past, Solver, rollout_chunks, sample_segment
from moveset.rdm.staircase import Staircase
from moveset.rdm.transport import Transport
from tests.samplers import IDENTITY, SEEDS, SHAPE, Denoiser, Scaled, calls, run, solver, texts


def in_sequence(net, how, transport, text, seeds, count):
    """Segments (B, N, n, D) one after the other, as a stream makes them."""
    made, past = [], torch.zeros(len(seeds), *SHAPE)
    for k in range(count):
        index = torch.full((len(seeds),), k)

        def denoise(x, t, before, before_t, index=index):
            return net(x, t, before, before_t, index, index.tolist())

        made.append(sample_segment(denoise, how, seeds, [k] * len(seeds), past, transport, text[k]))
        past = Past(made[-1], seeds, [k] * len(seeds), text[k], torch.ones(len(seeds), dtype=torch.bool))
    return torch.stack(made, dim=1)


@pytest.mark.parametrize("transport", [IDENTITY, Transport(Scaled())], ids=["identity", "flow"])
@pytest.mark.parametrize(
    "options",
    [{}, {"eta": 1.0}, {"past_lag": 1}, {"past_lag": 3, "eta": 0.5}, {"past_lag": 5}, {"colour": lambda z: 2 * z}],
    ids=["ddim", "ddpm", "noisy past", "noisy past and steps", "clean past", "coloured"],
)
def test_in_sequence_is_the_staircase_that_waits_for_finished_segments(options, transport):
    """To the last bit, with the same evaluations."""
    plan, net, oracle = Staircase(5, 4, 5, lag=5), Denoiser(), Denoiser()
    want = run(plan, transport, oracle, **options)
    assert torch.equal(in_sequence(net, solver(5, **options), transport, texts(4), SEEDS, 4), want)
    assert net.seen == oracle.seen
    assert net.waves == calls(plan) == plan.end(3)


def test_rows_of_unlike_streams_do_not_see_each_other():
    """One stream begins, one goes on, one goes on from a motion that was given: together as alone."""
    how, transport, text = solver(5, past_lag=2, eta=0.3), Transport(Scaled()), texts(3)
    seeds, numbers, noisy = [5, 6, 7], [0, 3, 1], torch.tensor([False, True, False])
    pooled, before = torch.cat(text)[:3], torch.cat(text)[3:]
    left = torch.randn(3, *SHAPE, generator=torch.Generator().manual_seed(0))
    left[0] = 0.0

    def make(rows):
        index, told = torch.tensor(numbers)[rows], []

        def denoise(x, t, past, past_t):
            told.append(past_t.tolist())
            return 0.5 * x + 0.3 * past + (t + past_t)[:, None, None] / 3000 + 0.01 * index[:, None, None]

        of = [seeds[k] for k in rows], [numbers[k] for k in rows]
        past = Past(left[rows], of[0], [max(n - 1, 0) for n in of[1]], before[rows], noisy[rows])
        return sample_segment(denoise, how, *of, past, transport, pooled[rows]), told

    together, levels_told = make([0, 1, 2])
    assert levels_told == [[0, level, 0] for level in (600, 400, 200, 0, 0)]
    for k in range(3):
        assert torch.equal(together[k : k + 1], make([k])[0])


@pytest.mark.parametrize(("frames", "chunks"), [(196, 5), (200, 5), (40, 1), (1, 1)])
def test_chunks_follow_the_last_frames(frames, chunks):
    asked, schedule = [], cosine(10)

    def denoise(x, t, prefix, number):
        assert x.shape == (2, 40, 4)
        asked.append((number, int(t[0]), prefix))
        return 0.1 * x + prefix[:, -1:] + 0.01 * torch.arange(40)[:, None]

    prefix = torch.tensor([1.0, 2.0, 3.0, 4.0]).expand(2, 20, 4)
    made = rollout_chunks(denoise, schedule, prefix, frames, SEEDS)
    assert made.shape == (2, frames, 4)
    assert [(number, t) for number, t, _ in asked] == [(c, t) for c in range(chunks) for t in range(10, 0, -1)]
    for number, _, seen in asked:
        assert torch.equal(seen, prefix if number == 0 else made[:, 40 * number - 20 : 40 * number])
    longer = rollout_chunks(denoise, schedule, prefix, frames + 40, SEEDS)
    assert torch.equal(longer[:, :frames], made)


def test_a_network_is_told_more_noise_than_there_is_and_never_more_than_all():
    shifted = Solver(schedule=linear(), levels=(1000, 500, 30, 0), time_shift=0.1)
    seen = []

    def denoise(x, t, *_):
        seen.append(int(t))
        return x

    sample_segment(denoise, shifted, (0,), (0,), torch.zeros(1, 3, 1))
    assert seen == [1000, 550, 33]


def test_a_prefix_longer_than_a_chunk_keeps_its_newest_frames():
    seen = []

    def denoise(x, t, prefix, number):
        seen.append(prefix)
        return torch.full_like(x, number + 1.0)

    rollout_chunks(denoise, cosine(4), torch.zeros(2, 5, 1), 6, SEEDS, chunk=2)
    assert [prefix[0, :, 0].tolist() for prefix in seen[::4]] == [[0, 0, 0, 0, 0], [0, 0, 0, 1, 1], [0, 1, 1, 2, 2]]


def test_chunks_of_a_network_without_a_prefix_follow_nothing():
    seen = []

    def denoise(x, t, prefix, number):
        seen.append(prefix.shape)
        return x

    assert rollout_chunks(denoise, cosine(4), torch.zeros(2, 0, 1), 6, SEEDS, chunk=2).shape == (2, 6, 1)
    assert set(seen) == {(2, 0, 1)}


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


@pytest.mark.parametrize("past_lag", [0, 7])
def test_a_past_is_told_within_the_steps(past_lag):
    with pytest.raises(InputError, match=f"past_lag {past_lag} is not in 1 to 6"):
        solver(6, past_lag=past_lag)
