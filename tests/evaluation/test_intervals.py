"""The papers' intervals by hand, and what may be called a difference."""

import math

import pytest
import torch

from moveset.errors import InputError
from moveset.evaluation.intervals import Interval, clear


def test_the_formula_of_the_papers():
    values = [0.1, 0.4, 0.4, 0.5]
    found = Interval.of(values)
    assert found.mean == pytest.approx(0.35)
    deviation = math.sqrt((0.25**2 + 0.05**2 + 0.05**2 + 0.15**2) / 4)  # of the population, not of a sample
    assert found.half_width == pytest.approx(1.96 * deviation / 2)
    assert (found.low, found.high) == (found.mean - found.half_width, found.mean + found.half_width)


def test_equal_repeats_have_no_width_and_a_single_one_an_unknown_width():
    assert Interval.of([2.0] * 20) == Interval(2.0, 0.0)
    assert Interval.of([2.0]) == Interval(2.0, math.inf)
    assert not clear(Interval.of([2.0]), Interval.of([9.0]))
    with pytest.raises(InputError, match="finite"):
        Interval.of([])
    with pytest.raises(InputError, match="finite"):
        Interval.of([1.0, math.nan])


def test_the_interval_covers_the_truth_of_many_repeats():
    generator = torch.Generator().manual_seed(0)
    draws = torch.randn(1000, 20, generator=generator, dtype=torch.float64) + 5.0
    inside = sum(found.low <= 5.0 <= found.high for found in map(Interval.of, draws.tolist()))
    # Population deviation and 1.96 instead of Student's 2.09: a little short of 95 %.
    assert 900 <= inside <= 960


@pytest.mark.parametrize("interval", [Interval(0.5, 0.25), Interval(0.5, math.inf)])
def test_json_and_back(interval):
    assert Interval.from_json(interval.to_json()) == interval
    assert "Infinity" not in repr(interval.to_json())
    with pytest.raises(InputError, match="mean"):
        Interval.from_json({"interval": 0.1})


def test_disjoint_or_not():
    assert clear(Interval(0.0, 1.0), Interval(2.1, 1.0))
    assert clear(Interval(2.1, 1.0), Interval(0.0, 1.0))
    assert not clear(Interval(0.0, 1.0), Interval(2.0, 1.0))  # touching is not apart
    assert not clear(Interval(0.0, 5.0), Interval(0.5, 0.1))
