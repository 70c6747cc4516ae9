"""A finished segment that is told noisily: at which level, with which noise, and when it stays clean."""

import pytest
import torch

from moveset.diffusion.steps import add_noise
from moveset.rdm.noise import PAST
from moveset.rdm.sampler import Stream
from moveset.rdm.staircase import Staircase
from moveset.rdm.state import StreamState
from moveset.rdm.transport import Transport
from tests.samplers import IDENTITY, SCHEDULE, SEEDS, SHAPE, Denoiser, Scaled, noise_of_items, run, settings, texts


@pytest.mark.parametrize("transport", [IDENTITY, Transport(Scaled())], ids=["identity", "flow"])
@pytest.mark.parametrize("past_lag", [1, 3, 5])
def test_a_finished_past_is_told_at_the_level_it_is_said_to_have(transport, past_lag):
    """What the network is told of the segment before is that segment's y with one noise, at the level told, pushed."""
    plan, text, told = Staircase(5, 4, 5, lag=5), texts(4), []

    def watch(x, t, prev, prev_t, index, numbers):
        told.append((numbers[0], int(t[0]), int(prev_t[0]), prev))
        return Denoiser()(x, t, prev, prev_t, index, numbers)

    made = run(plan, transport, watch, past_lag=past_lag)
    for segment, t, prev_t, prev in told:
        assert prev_t == (max(t - 200 * past_lag, 0) if segment else 0)
        if not segment:
            assert prev.eq(0).all()
            continue
        before, index = segment - 1, torch.full((2,), segment - 1)
        left, noise = made[:, before], noise_of_items(SEEDS, before, PAST, SHAPE)
        noisy = add_noise(SCHEDULE, transport.pull(left, index, text[before]), noise, torch.full((2,), prev_t))
        assert torch.equal(prev, transport.push(noisy, index, text[before]) if prev_t else left)


def test_a_past_that_is_told_all_steps_ahead_is_told_clean():
    plan = Staircase(5, 4, 5, lag=5)
    assert torch.equal(run(plan), run(plan, past_lag=5))
    assert not torch.equal(run(plan), run(plan, past_lag=1))
    # The first segment has no past.
    assert torch.equal(run(plan)[:, 0], run(plan, past_lag=1)[:, 0])


def test_the_noise_of_the_past_is_coloured_like_any_other():
    told = {}

    def watch(x, t, prev, prev_t, index, numbers):
        told.setdefault(numbers[0], prev)
        return torch.zeros_like(x)

    twice = {"colour": lambda z: 2 * z, "past_lag": 1}
    run(Staircase(5, 2, 5, lag=5), IDENTITY, watch, **twice)
    noise = noise_of_items(SEEDS, 0, PAST, SHAPE)
    level = torch.full((2,), 800)
    torch.testing.assert_close(told[1], add_noise(SCHEDULE, torch.zeros_like(noise), 2 * noise, level))


def test_a_motion_that_was_given_is_told_clean():
    """A state without the embedding of its finished segment, as of a seed motion, or of before it was kept."""
    plan, seen = Staircase(5, None, 5, lag=5), []

    def watch(x, t, prev, prev_t, index, numbers):
        seen.append((numbers[0], prev_t.tolist()[0], prev))
        return 0.5 * x

    given = torch.ones(2, *SHAPE)
    state = StreamState(wave=plan.begin(1), finished=1, left=given)
    live = Stream(watch, Transport(Scaled()), settings(plan, past_lag=1), SEEDS, SHAPE, texts(4).__getitem__, state)
    next(live)
    assert all(level == 0 and torch.equal(prev, given) for _, level, prev in seen)
    next(live)
    assert [level for segment, level, _ in seen if segment == 2] == [800, 600, 400, 200, 0]
