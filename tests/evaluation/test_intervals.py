"""Intervals are those of Student's t."""

import math

import pytest
import torch

from moveset.errors import InputError
from moveset.evaluation.intervals import Interval, student_quantile

stats = pytest.importorskip("scipy.stats")


@pytest.mark.parametrize("count", [2, 3, 4, 5, 10, 20, 1000])
def test_intervals_are_those_of_student(count: int):
    values = torch.randn(count, generator=torch.Generator().manual_seed(count), dtype=torch.float64).tolist()
    found, oracle = Interval.of(values), stats.ttest_1samp(values, 0.0).confidence_interval(0.95)
    ends = found.mean - found.half_width, found.mean + found.half_width
    assert ends == pytest.approx((oracle.low, oracle.high), rel=1e-9)


def test_quantiles_of_every_number_of_repeats():
    freedom = range(1, 200)
    assert [student_quantile(k) for k in freedom] == pytest.approx(stats.t.ppf(0.975, freedom), rel=1e-11)


def test_equal_repeats_have_no_width_and_a_single_one_an_unknown_width():
    assert Interval.of([2.0] * 20) == Interval(2.0, 0.0)
    assert Interval.of([2.0]) == Interval(2.0, math.inf)
    for wrong in ([], [1.0, math.nan]):
        with pytest.raises(InputError, match="finite"):
            Interval.of(wrong)


@pytest.mark.parametrize("interval", [Interval(0.5, 0.25), Interval(0.5, math.inf)])
def test_json_and_back(interval):
    assert Interval.from_json(interval.to_json()) == interval
    assert "Infinity" not in repr(interval.to_json())
    with pytest.raises(InputError, match="mean"):
        Interval.from_json({"interval": 0.1})
