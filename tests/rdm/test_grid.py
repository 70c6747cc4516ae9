"""Segments of sequences, and cells of the grid by their formulas."""

from itertools import pairwise

import pytest
import torch

from moveset.diffusion.schedule import linear
from moveset.diffusion.steps import add_noise, denoise_step, over
from moveset.errors import InputError
from moveset.models.flow import FlowConfig
from moveset.rdm.grid import Draws, GridConfig, corrupt, draw, left_of_copy
from moveset.rdm.transport import Transport

SCHEDULE, N, D = linear(), 4, 6


def _rand(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


@pytest.fixture(scope="module")
def flow():
    torch.manual_seed(0)
    made = FlowConfig(
        features=D, blocks=2, hidden=8, text_dim=3, text_context=2, index_context=2, max_index=3, log_scale=0.3
    ).build()
    for block in made.blocks:
        block.out.reset_parameters()
    return made


INDEX = torch.tensor([0, 1, 2, 5])
CLEAN, PREV, FIRST = (_rand(4, N, D, seed=k) for k in (1, 2, 3))
SAID, BEFORE = _rand(4, 3, seed=4), _rand(4, 3, seed=5)
LEVELS, PREV_LEVELS = torch.tensor([1000, 700, 30, 400]), torch.tensor([3, 699, 0, 250])


def cells(config, transport, draws, first=FIRST):
    return corrupt(config, SCHEDULE, transport, CLEAN, PREV, first, INDEX, SAID, BEFORE, draws)


def noised(y, noise, level):
    a = float(SCHEDULE.alpha_bar[level])
    return a**0.5 * y + (1 - a) ** 0.5 * noise


def power(flow, x, times, said, number, inverse=False):
    context = flow.context(said, torch.tensor([number]))
    for _ in range(times):
        x = (flow.inverse if inverse else flow)(x, context)
    return x


@pytest.mark.parametrize("condition", ["below", "previous", "clean"])
def test_levels_of_the_neighbour_are_as_configured(condition):
    config = GridConfig(frames=2, condition=condition)
    draws = draw(config, SCHEDULE, (4000, 2, 1), torch.Generator().manual_seed(0))
    t, before = draws.t_B, draws.prev_t_B
    assert 1 <= int(t.min()) < 5
    assert 996 < int(t.max()) <= 1000
    assert abs(float(t.float().mean()) - 500.5) < 5 * 288.7 / 4000**0.5
    if condition == "previous":
        assert torch.equal(before, t - 1)
    elif condition == "clean":
        assert not before.any()
    else:
        assert bool(((before >= 0) & (before < t)).all())
        # Uniform in 0 … t - 1, for every t: the share of the way has mean 1/2 and deviation 0.29.
        share = (before.double() + 0.5) / t
        assert abs(float(share.mean()) - 0.5) < 0.02
        assert abs(float(share.std()) - 12**-0.5) < 0.02
        assert (before[t <= 10] == 0).any()


def test_noise_is_shared_only_if_asked():
    for shared in (False, True):
        config = GridConfig(frames=2, share_noise=shared)
        draws = draw(config, SCHEDULE, (500, 2, 3), torch.Generator().manual_seed(0))
        assert torch.equal(draws.noise_BnD, draws.prev_noise_BnD) == shared
        if not shared:
            assert float((draws.noise_BnD * draws.prev_noise_BnD).mean()) == pytest.approx(0, abs=0.1)
        again = draw(config, SCHEDULE, (500, 2, 3), torch.Generator().manual_seed(0))
        assert draws.copied_B is None
        assert all(torch.equal(getattr(draws, name), getattr(again, name)) for name in list(vars(draws))[:4])


@pytest.mark.parametrize("cap", [1, 3])
def test_a_cell_is_the_segment_noised_in_its_own_coordinates(flow, cap):
    draws = Draws(LEVELS, PREV_LEVELS, _rand(4, N, D, seed=6), _rand(4, N, D, seed=7))
    cell = cells(GridConfig(frames=N), Transport(flow, cap), draws)
    assert torch.equal(cell.t_B, LEVELS)
    assert torch.equal(cell.prev_t_B, PREV_LEVELS)
    for row, number in enumerate(INDEX.tolist()):
        one = slice(row, row + 1)
        for got, x, said, at, level, noise in (
            (cell.x_BnD, CLEAN, SAID, number, LEVELS, draws.noise_BnD),
            (cell.prev_BnD, PREV, BEFORE, max(number - 1, 0), PREV_LEVELS, draws.prev_noise_BnD),
        ):
            y = power(flow, x[one], min(at, cap), said[one], at, inverse=True)
            want = power(flow, noised(y, noise[one], level[row]), min(at, cap), said[one], at)
            torch.testing.assert_close(got[one], want, rtol=1e-4, atol=1e-4)


def test_a_clean_cell_is_the_segment_itself(flow):
    zeros = torch.zeros(4, dtype=torch.long)
    cell = cells(GridConfig(frames=N), Transport(flow, 3), Draws(zeros, zeros, CLEAN * 9, CLEAN * 9))
    torch.testing.assert_close(cell.x_BnD, CLEAN, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(cell.prev_BnD[1:], PREV[1:], rtol=1e-4, atol=1e-4)


def test_the_printed_cell_is_made_of_the_first_segment(flow):
    noise = _rand(4, N, D, seed=6)
    config = GridConfig(frames=N, anchor="first", share_noise=True, condition="previous")
    cell = cells(config, Transport(flow, 5), Draws(LEVELS, LEVELS - 1, noise, noise))
    for row, number in enumerate(INDEX.tolist()):
        one = slice(row, row + 1)
        want = power(flow, noised(FIRST[one], noise[one], LEVELS[row]), number, SAID[one], number)
        torch.testing.assert_close(cell.x_BnD[one], want, rtol=1e-4, atol=1e-4)
        before = max(number - 1, 0)
        want = power(flow, noised(FIRST[one], noise[one], LEVELS[row] - 1), before, BEFORE[one], before)
        torch.testing.assert_close(cell.prev_BnD[one], want, rtol=1e-4, atol=1e-4)
    with pytest.raises(InputError, match="first segment"):
        cells(config, Transport(flow, 5), Draws(LEVELS, LEVELS - 1, noise, noise), first=None)


def test_shared_noise_gives_clean_data_away():
    """The noise cancels in s_t' x_t - s_t x_t': what is left is clean data."""
    config = GridConfig(frames=N, share_noise=True, condition="previous")
    draws = draw(config, SCHEDULE, (4, N, D), torch.Generator().manual_seed(3))
    cell = cells(config, Transport(None), draws)
    alpha, sigma = (f(cell.t_B)[:, None, None] for f in (SCHEDULE.alpha, SCHEDULE.sigma))
    alpha_p, sigma_p = (f(cell.prev_t_B)[:, None, None] for f in (SCHEDULE.alpha, SCHEDULE.sigma))
    left = sigma_p * cell.x_BnD - sigma * cell.prev_BnD
    torch.testing.assert_close(left, sigma_p * alpha * CLEAN - sigma * alpha_p * PREV, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("eta", [0.0, 1.0])
def test_an_entangled_cell_is_where_a_sampler_comes_to_that_began_with_a_copy(flow, eta):
    """Steps of any length from a copy of the neighbour's state, with a denoiser that is right and no fresh noise."""
    entry, levels = torch.tensor([900, 900, 40, 7]), (900, 700, 650, 40, 25, 7, 3)
    noise, transport = _rand(4, N, D, seed=6), Transport(flow, 3)
    own = transport.pull(CLEAN, INDEX, SAID)
    neighbour = transport.pull(PREV, (INDEX - 1).clamp(min=0), BEFORE)
    z = add_noise(SCHEDULE, neighbour, noise, entry)
    for t, s in pairwise(levels):
        later = denoise_step(SCHEDULE, z, own, *(torch.full((4,), k) for k in (t, s)), eta, torch.zeros_like(z))
        z = torch.where((t <= entry)[:, None, None], later, z)
    q = left_of_copy(SCHEDULE, entry, torch.full((4,), 3))
    left, mine = (q, torch.ones(4)) if eta == 0 else (q.square(), q)
    at = torch.full((4,), 3)
    draws = Draws(at, at - 1, over(mine, noise) * noise, noise, left)
    cell = cells(GridConfig(frames=N, entangled=1.0), transport, draws)
    torch.testing.assert_close(cell.x_BnD[1:], transport.push(z, INDEX, SAID)[1:], rtol=1e-3, atol=1e-4)
    # A first segment has no neighbour to copy.
    assert torch.equal(cell.x_BnD[:1], cells(GridConfig(frames=N), transport, draws).x_BnD[:1])


def test_entangled_noise_is_what_the_steps_leave_of_the_neighbours():
    rows, at = (40_000, 1, 1), torch.Generator().manual_seed
    for shared in (False, True):
        draws = draw(GridConfig(frames=2, entangled=1.0, share_noise=shared), SCHEDULE, rows, at(1))
        noise, other, q = draws.noise_BnD.flatten(), draws.prev_noise_BnD.flatten(), draws.copied_B
        assert abs(float(noise.std()) - 1) < 0.02 > abs(float(other.std()) - 1)
        assert bool(((draws.prev_t_B < draws.t_B) & (q > 0) & (q <= 1)).all())
        if shared:
            assert torch.equal(noise, other)
            continue
        # The neighbour went on from the same noise: by the product of both shares the noises go together.
        both = q.sqrt() * q.sqrt() * left_of_copy(SCHEDULE, draws.t_B, draws.prev_t_B)
        assert float((noise * other).mean()) == pytest.approx(float(both.mean()), abs=0.02)
        for low, high in ((1, 10), (10, 100), (100, 1000)):  # each decade of entries as often
            assert float(((draws.t_B >= low) & (draws.t_B <= high)).float().mean()) > 0.2
    some = draw(GridConfig(frames=2, entangled=0.25), SCHEDULE, rows, at(2))
    assert float((some.copied_B > 0).float().mean()) == pytest.approx(0.25, abs=0.02)
    rest = some.copied_B == 0
    assert float(some.t_B[rest].float().mean()) == pytest.approx(500.5, abs=10)
    assert float((some.noise_BnD * some.prev_noise_BnD)[rest].mean()) == pytest.approx(0, abs=0.03)


@pytest.mark.parametrize(
    ("setting", "message"),
    [({"frames": 1}, "too short"), ({"anchor": "last"}, "segment, first"), ({"condition": "noisy"}, "below, previous")],
)
def test_nonsense_is_refused(setting, message):
    with pytest.raises(InputError, match=message):
        GridConfig(**setting)


def test_a_share_of_neighbours_is_clean():
    generator = torch.Generator().manual_seed(0)
    drawn = draw(GridConfig(clean_share=0.3), linear(), (4000, 2, 1), generator)
    assert abs(float((drawn.prev_t_B == 0).float().mean()) - 0.3) < 0.03
    assert (drawn.prev_t_B < drawn.t_B).all()
    with pytest.raises(InputError, match="clean_share"):
        GridConfig(clean_share=1.5)
