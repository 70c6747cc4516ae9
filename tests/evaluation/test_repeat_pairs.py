"""What two rows were given alike cancels in the difference of their repeats."""

from pathlib import Path

import pytest
import torch

from moveset.evaluation.columns import ALL
from moveset.evaluation.intervals import Interval, clear
from moveset.evaluation.markdown import markdown
from moveset.evaluation.repeat_pairs import LEAST, repeat_pairs, student_interval, verdict
from moveset.evaluation.table import load_table
from tests.evaluation.results import result_json, suite_folder

SHARED = [0.31, 0.18, 0.27, 0.22, 0.35, 0.25]


def row(fid: list[float], **changed: object) -> dict:
    found = Interval.of(fid)
    return (
        result_json({"fid": (found.mean, found.half_width)}) | {"repeats": [{"fid": value} for value in fid]} | changed
    )


def test_a_small_difference_that_is_always_there_shows():
    rows = {"a": {"fid": SHARED}, "b": {"fid": [v - 0.01 for v in SHARED]}}
    assert not clear(*(Interval.of(values["fid"]) for values in rows.values()))
    (found,) = repeat_pairs(rows, {"a": (), "b": ("a",)})
    assert (found.row, found.reference, found.repeats) == ("b", "a", len(SHARED))
    assert found.differences["fid"].mean == pytest.approx(-0.01)
    assert verdict(ALL["fid"], found.differences["fid"]) == "better"


def test_pairing_covers_the_truth_as_often_as_it_says():
    """Rows that share most of their noise: the interval of the difference holds the true one in 95 of 100 trials."""
    generator, covered = torch.Generator().manual_seed(0), 0
    for _ in range(400):
        shared, *own = torch.randn(3, 20, generator=generator, dtype=torch.float64)
        rows = {"a": {"fid": (shared + 0.1 * own[0]).tolist()}, "b": {"fid": (shared + 0.1 * own[1] + 0.3).tolist()}}
        (found,) = repeat_pairs(rows, {"b": ("a",)})
        difference = found.differences["fid"]
        assert difference.half_width < 0.2 < Interval.of(rows["a"]["fid"]).half_width
        covered += abs(difference.mean - 0.3) <= difference.half_width
    assert 0.92 <= covered / 400 <= 0.98


@pytest.mark.parametrize("count", [LEAST, 7, 10, 20, 1000])
def test_intervals_are_those_of_student(count: int):
    stats = pytest.importorskip("scipy.stats")
    values = torch.randn(count, generator=torch.Generator().manual_seed(count), dtype=torch.float64).tolist()
    found, oracle = student_interval(values), stats.ttest_1samp(values, 0.0).confidence_interval(0.95)
    assert found.low == pytest.approx(oracle.low, abs=0.003 * found.half_width)
    assert found.high == pytest.approx(oracle.high, abs=0.003 * found.half_width)


def test_the_same_row_twice_is_no_difference():
    (found,) = repeat_pairs({"a": {"r1": SHARED}, "b": {"r1": SHARED}}, {"b": ("a",)})
    assert found.differences["r1"] == Interval(0.0, 0.0)
    assert verdict(ALL["r1"], found.differences["r1"]) == ""


@pytest.mark.parametrize(
    ("metric", "mean", "said"), [("r1", 0.1, "better"), ("r1", -0.1, "worse"), ("fid", 0.1, "worse")]
)
def test_which_way_is_better(metric: str, mean: float, said: str):
    assert verdict(ALL[metric], Interval(mean, 0.05)) == said
    assert verdict(ALL[metric], Interval(mean, 0.1)) == ""  # touching zero


def test_only_what_both_have_is_paired():
    rows = {
        "a": {"fid": SHARED, "r1": SHARED, "diversity": SHARED},
        "b": {"fid": SHARED[:LEAST], "mm_dist": SHARED[:LEAST], "diversity": SHARED[:LEAST]},
        "few": {"fid": SHARED[: LEAST - 1]},
    }
    (found,) = repeat_pairs(rows, {"b": ("a", "b", "gone"), "few": ("a",), "gone": ("a",)})
    assert (found.row, found.reference, found.repeats) == ("b", "a", LEAST)
    assert list(found.differences) == ["fid"]  # diversity has no better way, but a nearest one


def test_a_report_says_what_differs_repeat_by_repeat(tmp_path: Path):
    results = {"lcm-1": row(SHARED), "pcm-1": row([v - 0.01 for v in SHARED]), "pcm-4": row([v + 0.02 for v in SHARED])}
    text = markdown(load_table(suite_folder(tmp_path / "t", "motionpcm", results)))
    part = text.split("What differs repeat by repeat")[1].split("## Targets")[0]
    assert "| PCM, 1 step − LCM, 1 step | 6 | **−0.010 ± 0.000** |" in part
    assert "| PCM, 4 steps − LCM, 1 step | 6 | <u>+0.020 ± 0.000</u> |" in part


def test_repeats_of_another_seed_are_not_paired(tmp_path: Path):
    other = {"split": "test", "wording": "known", "group": 32, "seed": 1}
    results = {"lcm-1": row(SHARED), "pcm-4": row(SHARED), "pcm-1": row(SHARED, protocol=other)}
    table = load_table(suite_folder(tmp_path / "t", "motionpcm", results))
    assert [(found.row, found.reference) for found in table.pairs()] == [("pcm-4", "lcm-1")]
