"""What differs outside the intervals, and which targets are met, of rows by hand."""

import pytest

from moveset.evaluation.columns import ALL
from moveset.evaluation.intervals import Interval
from moveset.evaluation.table import Measured
from moveset.evaluation.targets import at_least, checks, differences, outside, physical, within
from tests.evaluation.results import result_json


@pytest.mark.parametrize(
    ("a", "b", "verdict"),
    [
        ((10.50, 0.1), (9.49, 0.1), "tied"),  # as far away, on either side
        ((10.50, 0.1), (9.20, 0.1), "better"),
        ((10.80, 0.1), (9.49, 0.1), "worse"),
        ((10.05, 0.1), (10.30, 0.1), "better"),  # real motion lies within it
        ((10.00, 0.4), (10.30, 0.1), "tied"),
    ],
)
def test_what_is_to_be_near_real_motion_differs_by_its_distance(a, b, verdict):
    rows = {name: {"diversity": Interval(*value)} for name, value in (("a", a), ("b", b), ("real", (10.0, 0.1)))}
    (found,) = differences(rows, {"a": ["b"]})
    assert getattr(found, verdict) == ("Diversity",)


def test_one_repeat_has_no_interval_and_proves_nothing():
    alone = {"a": {"fid": Interval(0.1, float("inf"))}, "b": {"fid": Interval(9.0, 0.0)}}
    (found,) = differences(alone, {"a": ["b"]})
    assert (found.open, found.tied) == (("FID",), ())
    assert found.sentence({"a": "A", "b": "B"}) == "A against B: undecided by a single repeat in FID."
    assert outside(alone, "a", "b", "fid", "{}").verdict == "undecided by a single repeat"
    assert at_least(alone, "b", "a", "fid", "{}").verdict == "undecided by a single repeat"
    assert at_least(alone, "a", "b", "fid", "{}").verdict == "met"
    raw = result_json({"fid": (0.1, None)}, repeats=1)
    assert Measured.of(raw, "x").metrics["fid"].half_width == float("inf")


ROWS = {
    "good": {"fid": Interval(0.1, 0.01), "r1": Interval(0.6, 0.01), "jerk": Interval(60.0, 0.1)},
    "near": {"fid": Interval(0.115, 0.01), "r1": Interval(0.59, 0.01), "jerk": Interval(77.9, 0.1)},
    "bad": {"fid": Interval(1.0, 0.01), "r1": Interval(0.3, 0.01), "jerk": Interval(78.1, 0.1)},
    "real": {"jerk": Interval(60.0, 0.1), "skating": Interval(0.0, 0.0)},
}


@pytest.mark.parametrize(
    ("key", "reference", "metric", "verdict"),
    [
        ("good", "bad", "fid", "met"), ("good", "near", "fid", "not met"), ("bad", "good", "fid", "not met"),
        ("good", "bad", "r1", "met"), ("bad", "good", "r1", "not met"), ("good", "none", "fid", "not measured"),
    ],
)  # fmt: skip
def test_better_means_outside_the_intervals(key: str, reference: str, metric: str, verdict: str):
    assert outside(ROWS, key, reference, metric, "{}").verdict == verdict


@pytest.mark.parametrize(
    ("key", "reference", "metric", "verdict"),
    [
        ("good", "near", "fid", "met"), ("near", "good", "fid", "met within the intervals"),
        ("bad", "good", "fid", "not met"), ("near", "good", "r1", "met within the intervals"),
        ("bad", "good", "r1", "not met"), ("good", "bad", "r1", "met"),
    ],
)  # fmt: skip
def test_at_least_allows_a_tie(key: str, reference: str, metric: str, verdict: str):
    assert at_least(ROWS, key, reference, metric, "{}").verdict == verdict


def test_a_factor_bounds_from_above_or_below():
    assert within(ROWS, "good", "bad", "fid", 0.1, "").verdict == "met"
    assert within(ROWS, "near", "bad", "fid", 0.1, "").verdict == "not met"
    assert within(ROWS, "bad", "good", "r1", 0.5, "").verdict == "met"
    assert within(ROWS, "bad", "good", "r1", 0.51, "").verdict == "not met"
    assert within(ROWS, "near", "bad", "fid", 0.1, "").numbers.endswith(", 0.12 times")


def test_physical_metrics_are_held_to_real_motion():
    assert physical(ROWS, "near", ALL["jerk"], "").verdict == "met"
    assert physical(ROWS, "bad", ALL["jerk"], "").verdict == "not met"
    rows = {"a": {"skating": Interval(0.1, 0.0)}, **ROWS}
    assert physical(rows, "a", ALL["skating"], "").numbers.endswith("no ratio to zero")


def test_targets_of_streams():
    rows = {
        "md-7": {"fid": Interval(2.0, 0.1), "r1": Interval(0.3, 0.0)},
        "rdm-7": {"fid": Interval(0.3, 0.1), "r1": Interval(0.5, 0.0)},
        "rdm-pcm-1": {"fid": Interval(0.35, 0.1), "r1": Interval(0.39, 0.0)},
    }
    labels = {"rdm-pcm-1": "One", "rdm-pcm-2": "Two"}
    found = {check.target: check.verdict for check in checks("rdm", rows, [], labels)}
    assert found["RDM-7's FID is at most a tenth of MD-7's"] == "not met"
    assert found["One: FID within 20 % of RDM-7's"] == "met"
    assert found["One: R@1 within 20 % of RDM-7's"] == "not met"
    assert found["Two: FID within 20 % of RDM-7's"] == "not measured"
