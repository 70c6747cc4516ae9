"""The plan: formulas against counted cells, and the order in which cells may be evaluated."""

import itertools

import pytest

from moveset.errors import InputError
from moveset.rdm.staircase import Staircase, levels
from tests.samplers import calls, rows

PLANS = [
    Staircase(steps, segments, start, shape, lag)
    for steps, segments in itertools.product((4, 10, 20), (1, 4, 7, 14))
    for shape in ("triangle", "parallelogram")
    for start in {0, 1, 3, segments, steps // 3, steps}
    if start <= steps
    for lag in {1, 3, steps}
    if lag <= steps
]


@pytest.mark.parametrize("segments", [1, 4, 7, 14])
def test_formulas_count_what_is_planned(segments):
    for plan in PLANS:
        if plan.segments == segments:
            check_formulas(plan)


def check_formulas(plan):
    waves = list(plan.wavefront())
    cells = [cell for wave in waves for cell in wave]
    assert len(cells) == len(set(cells))
    assert len(waves) == plan.end(plan.segments - 1)
    assert sorted(rows(plan)) == sorted(cells)
    for segment in range(plan.segments):
        mine = [step for number, step in cells if number == segment]
        assert mine == list(range(plan.entry(segment), plan.steps))
        if mine:
            assert plan.end(segment) == 1 + max(w for w, wave in enumerate(waves) if (segment, plan.steps - 1) in wave)


@pytest.mark.parametrize("order", ["wavefront", "rows"])
def test_the_left_neighbour_is_exactly_the_lag_ahead_or_finished(order):
    for plan in PLANS:
        check_order(plan, plan.wavefront() if order == "wavefront" else ((cell,) for cell in rows(plan)))


def check_order(plan, waves):
    reached = {}
    for wave in waves:
        for segment, step in wave:
            assert reached.setdefault(segment, plan.entry(segment)) == step
            if segment:
                assert reached[segment - 1] == min(step + plan.lag, plan.steps)
        for segment, step in wave:
            reached[segment] = step + 1


@pytest.mark.parametrize(("segments", "more"), [(4, 9), (7, 27), (14, 104)])
def test_the_published_staircase_costs_what_its_shape_says(segments, more):
    plan = Staircase(100, segments, segments, "triangle")
    assert calls(plan) == 100 + more
    assert plan.end(segments - 1) == 100 + segments - 1


@pytest.mark.parametrize("segments", [4, 7, 14])
@pytest.mark.parametrize("lag", [1, 5, 20])
def test_the_full_grid_costs_as_much_as_autoregression_but_waits_less(segments, lag):
    plan = Staircase(20, segments, 20, lag=lag)
    assert calls(plan) == 20 * segments
    assert plan.end(segments - 1) == 20 + (segments - 1) * lag
    assert max(len(wave) for wave in plan.wavefront()) == min(segments, -(-20 // lag))


@pytest.mark.parametrize(
    ("plan", "cost", "most"),
    [
        (Staircase(20, 7, 20), 140, 7),
        (Staircase(20, 7, 7, "triangle"), 47, 4),
        (Staircase(20, 7, 5), 50, 5),
    ],
    ids=str,
)
def test_known_plans(plan, cost, most):
    assert (calls(plan), plan.end(6)) == (cost, 26)
    assert max(len(wave) for wave in plan.wavefront()) <= most


def test_a_triangle_leaves_what_is_beyond_it_to_the_flow():
    plan = Staircase(10, 14, 3, "triangle")
    assert [plan.denoised(j) for j in range(6)] == [10, 3, 2, 1, 0, 0]
    assert calls(plan) == 16
    assert not plan.has(4)
    assert not Staircase(10, 3, 10).has(3)


def test_an_endless_plan_has_waves_but_no_number_of_them():
    endless, long = Staircase(6, None, 4), Staircase(6, 500, 4)
    for ours, theirs in zip(itertools.islice(endless.wavefront(), 400), long.wavefront(), strict=False):
        assert ours == theirs
    assert endless.wave(1000, first=endless.wave(999)[0][0]) == endless.wave(1000)
    assert len(list(Staircase(6, None, 4, "triangle").wavefront())) == 10  # the flow does the rest


def test_levels_fall_to_the_clean_one():
    assert levels(1000) == tuple(range(1000, -1, -1))
    assert levels(10) == (1000, 900, 800, 700, 600, 500, 400, 300, 200, 100, 0)
    for steps in (1, 3, 7, 50, 333, 999):
        made = levels(steps)
        assert len(made) == steps + 1
        assert made[0] == 1000
        assert made[-1] == 0
        assert all(t > s for t, s in itertools.pairwise(made))
    with pytest.raises(InputError, match="1001 sampler steps"):
        levels(1001)


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (lambda: Staircase(0, 1, 0), "at least 1"),
        (lambda: Staircase(5, 0, 0), "at least 1"),
        (lambda: Staircase(5, 2, 6), "start 6"),
        (lambda: Staircase(5, 2, 5, lag=0), "lag 0"),
        (lambda: Staircase(5, 2, 5, lag=6), "lag 6"),
        (lambda: Staircase(5, 2, 5, "square"), "square"),
    ],
)
def test_a_plan_that_cannot_be_is_refused(made, message):
    with pytest.raises(InputError, match=message):
        made()
